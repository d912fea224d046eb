"""A sweep on a dask cluster of processes on this machine, workers killed in the middle of it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_sim.sweep.runner import run

pytest.importorskip("pyarrow")

pytestmark = pytest.mark.slow


def test_the_table_is_the_same_with_two_workers_killed(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")  # late: a second
    scenario = load_scenario("paper_5_free", {"timing.duration_s": 0.5})
    plan = plan_of(scenario, 150, starts=parse_starts("near:0.3"))
    here = run(plan, tmp_path / "here", workers=2)
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        killed: list[int] = []

        def kill(done: int, total: int) -> None:
            if done and len(killed) < 2:
                victim = next(iter(cluster.workers.values())).pid
                if victim is not None and victim not in killed:
                    killed.append(victim)
                    os.kill(victim, signal.SIGKILL)

        there = run(plan, tmp_path / "there", scheduler=cluster.scheduler_address, progress=kill)
    assert len(killed) == 2
    assert not there.failed
    assert there.table.read_bytes() == here.table.read_bytes()
