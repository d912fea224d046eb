"""Sweeps: 1000 flights of paper_5_free by two cores, drawn, flown, judged and written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench.session import Plan
from bench.table import Row, Target

_CORES = 2
_FLIGHT_S = 10.0
_LOOK_S = 1.0  # between two looks at the memory
_TICKS = 5 * 1000  # of all UAVs in one flight


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    runs = plan.of(1000, 100)
    _swept(50)  # compiled or loaded before it counts
    found = [_swept(runs) for _ in range(plan.of(3, 1))]
    many = _swept(plan.of(10_000, 200))
    per_s = [runs * _TICKS / one["wall_s"] for one in found]
    return [
        Row(
            f"{runs} flights of 10 s, N = 5, 2 workers",
            [one["wall_s"] for one in found],
            "s",
            target=Target(20.0),
        ),
        Row("the same", per_s, "UAV-ticks/s", target=Target(600_000.0, at_least=True)),
        Row("the same, CPU time per flight", [one["cpu_s"] / runs * 1e3 for one in found], "ms"),
        Row(
            f"memory of {plan.of(10_000, 200)} flights, all processes",
            [many["memory_mb"]],
            "MB",
            target=Target(1000.0),
        ),
    ]


def _swept(runs: int) -> dict[str, float]:
    """A sweep in a process of its own, on two cores."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "bench.sweep", str(runs), str(Path(folder) / "sweep")]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def _memory_mb() -> float:
    """Memory of this process and its children, what they share counted once [MB]."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    total = 0
    for pid in ("self", *children):
        try:
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue  # it has just ended
        total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total / 1024


def _main(runs: int, folder: Path) -> None:
    from ptnsbc_sim.scenario import load_scenario
    from ptnsbc_sim.sweep.draws import parse_starts
    from ptnsbc_sim.sweep.plan import plan_of
    from ptnsbc_sim.sweep.runner import run

    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:_CORES])
    scenario = load_scenario("paper_5_free", {"timing.duration_s": _FLIGHT_S})
    plan = plan_of(scenario, runs, starts=parse_starts("near:0.3"))
    memory, looked_s = 0.0, 0.0

    def look(done: int, total: int) -> None:
        nonlocal memory, looked_s
        if time.perf_counter() > looked_s + _LOOK_S:  # a look takes 8 ms from the flights
            memory, looked_s = max(memory, _memory_mb()), time.perf_counter()

    began = time.perf_counter()
    run(plan, folder, workers=_CORES, progress=look)
    wall_s, spent = time.perf_counter() - began, os.times()
    cpu_s = spent.user + spent.system + spent.children_user + spent.children_system
    print(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s, "memory_mb": memory}))


if __name__ == "__main__":
    _main(int(sys.argv[1]), Path(sys.argv[2]))
