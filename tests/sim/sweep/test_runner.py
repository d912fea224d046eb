"""Sweeps that are flown: the bits of `simulate`, whoever flies, and nothing lost."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path

import pytest

from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.sweep import runner
from ptnsbc_sim.sweep.draws import SweepError, parse_axis, parse_starts
from ptnsbc_sim.sweep.plan import SweepPlan, draw, plan_of
from ptnsbc_sim.sweep.rows import UNITS, SweepRow, rows_of
from ptnsbc_sim.sweep.runner import CHUNK_DRAWS, chunk_count, fly_chunk, run
from ptnsbc_sim.verdict.recording import recording_of

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
KAPPA = "gains.formation.kappa_1_s"


def base(name: str = "paper_5_free", **changes) -> Scenario:
    quick = {"timing.duration_s": 1.2, "gains.formation.deadline_s": 0.8}
    return load_scenario(name, {**quick, **changes})


def small(runs: int = 27, **rest) -> SweepPlan:
    axes = (parse_axis(f"{KAPPA}=1:3"),)
    return plan_of(base(), runs, axes=axes, starts=parse_starts("near:0.3"), **rest)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table of a sweep that one process has flown."""
    return run(small(), tmp_path_factory.mktemp("sweep") / "one", workers=1).table


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"plant.kind": "rigid_body_6dof", "formation.task": "relative_position"},
        {"world.gust_m_s": [1.0, 1.0, 0.5], "communication.loss": 0.2, "sensor.noise_m": 0.02},
    ],
    ids=["quadrotor", "rigid body", "disturbed"],
)
def test_a_row_has_the_figures_of_the_headless_flight(changes: dict) -> None:
    plan = plan_of(base("paper_5", **changes), 4, starts=parse_starts("near:0.2"))
    from io import BytesIO

    table = pq.read_table(BytesIO(fly_chunk(plan.to_json(), 0))).to_pylist()
    expected = []
    for k in range(4):
        scenario = draw(plan, k)
        expected += rows_of(k, scenario, recording_of(fly(scenario)))
    names = [field.name for field in fields(SweepRow)]
    assert table == [{name: getattr(row, name) for name in names} for row in expected]


def test_the_table_tells_units_plan_and_versions(flown: Path) -> None:
    table = pq.read_table(flown)
    assert table.num_rows == 27 * 5
    assert (
        table.column(f"drawn.{KAPPA}").to_pylist()[:5]
        == [table.column(f"drawn.{KAPPA}")[0].as_py()] * 5
    )
    assert table.schema.field("settling_s").metadata == {b"unit": b"s"}
    assert table.schema.field(f"drawn.{KAPPA}").metadata == {b"unit": b"1/s"}
    assert {"N", "m", "s", "N^2 s", ""} == set(UNITS.values())
    assert SweepPlan.from_json(table.schema.metadata[b"ptnsbc.plan"].decode()) == small()
    assert "kernels" in json.loads(table.schema.metadata[b"ptnsbc.made_by"])


@pytest.mark.slow
def test_a_sweep_goes_on_where_it_ended(flown: Path, tmp_path: Path) -> None:
    seen: list[int] = []

    def interrupted(done: int, total: int) -> None:
        seen.append(done)
        if done >= CHUNK_DRAWS:
            raise KeyboardInterrupt

    folder = tmp_path / "sweep"
    with pytest.raises(KeyboardInterrupt):
        run(small(), folder, workers=1, progress=interrupted)
    assert [path.name for path in (folder / "chunks").iterdir()] == ["00000.parquet"]
    done: list[int] = []
    result = run(small(), folder, workers=1, progress=lambda now, total: done.append(now))
    assert done[0] == CHUNK_DRAWS
    assert result.table.read_bytes() == flown.read_bytes()


def test_a_folder_of_another_plan_is_refused(flown: Path, tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="another plan"):
        run(small(28), flown.parent, workers=1)
    (tmp_path / "file").touch()
    with pytest.raises(SweepError, match="other files"):
        run(small(), tmp_path, workers=1)


@pytest.mark.parametrize("damage", ["other laws", "cut short", "overwritten"])
def test_flights_of_other_laws_are_not_mixed_with_those_of_today(
    tmp_path: Path, damage: str
) -> None:
    plan = small(2, stop_after_s=0.1)
    chunk = run(plan, tmp_path, workers=1).folder / runner.CHUNKS / "00000.parquet"
    assert not runner.held(tmp_path, plan)
    if damage == "other laws":
        table = pq.read_table(chunk)
        made_by = json.loads(table.schema.metadata[b"ptnsbc.made_by"]) | {"kernels": "of last week"}
        metadata = {**table.schema.metadata, b"ptnsbc.made_by": json.dumps(made_by).encode()}
        pq.write_table(table.replace_schema_metadata(metadata), chunk)
    else:
        data = chunk.read_bytes()
        chunk.write_bytes(
            data[:-5] if damage == "cut short" else data[:-40] + bytes(30) + data[-10:]
        )
    with pytest.raises(SweepError, match="other laws"):
        run(plan, tmp_path, workers=1)


@pytest.mark.slow
def test_flights_of_a_law_that_the_user_has_changed_are_not_mixed(tmp_path: Path) -> None:
    law = tmp_path / "my laws" / "still.py"
    law.parent.mkdir()
    law.write_text("def still(inputs):\n    return 0.0, 0.0, 0.0\n")
    plan = plan_of(base(law=f"{law}:still"), 2, stop_after_s=0.1, starts=parse_starts("near:0.1"))
    folder = tmp_path / "sweep"
    run(plan, folder, workers=1)
    assert not runner.held(folder, plan)
    law.write_text("def still(inputs):\n    return 0.0, 0.0, 0.1\n")
    with pytest.raises(SweepError, match="other laws"):
        run(plan, folder, workers=1)


@pytest.mark.slow
def test_a_chunk_that_fails_is_tried_once_more_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[int] = []

    def broken(text: str, index: int) -> bytes:
        tried.append(index)
        if index == 1:
            raise SweepError("draw 26: no such flight")
        return fly_chunk(text, index)

    monkeypatch.setattr(runner, "fly_chunk", broken)
    result = run(small(), tmp_path / "sweep", workers=1)
    (failed,) = result.failed
    assert (failed.index, failed.draws) == (1, range(25, 27))
    assert failed.error == "draw 26: no such flight"
    assert tried.count(1) == 2
    draws = set(pq.read_table(result.table).column("draw").to_pylist())
    assert draws == set(range(25))


def test_a_draw_that_cannot_be_flown_is_a_row_with_its_cause() -> None:
    plan = replace(small(2), axes=(parse_axis("plant.mass_kg=1.0,9.0"),))
    rows = pq.read_table(BytesIO(fly_chunk(plan.to_json(), 0))).to_pylist()
    lost = {row["draw"]: row for row in rows if row["verdict"] == "not flown"}
    assert sorted(lost) == [1, 3]
    assert "more than the weight" in lost[1]["cause"]
    assert lost[1]["drawn.plant.mass_kg"] == 9.0
    assert lost[1]["energy_n2_s"] is None
    assert {row["draw"] for row in rows} == {0, 1, 2, 3}


def _dying_once(text: str, index: int) -> bytes:
    """As fly_chunk; the process ends at the first try of chunk 1."""
    mark = Path(os.environ["PTNSBC_TEST_MARK"])
    if index == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fly_chunk(text, index)


@pytest.mark.slow
def test_a_worker_that_dies_loses_only_its_chunk(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By two workers; the table is that of one."""
    monkeypatch.setenv("PTNSBC_TEST_MARK", str(tmp_path / "mark"))
    monkeypatch.setattr(runner, "fly_chunk", _dying_once)
    result = run(small(), tmp_path / "sweep", workers=2)
    assert (tmp_path / "mark").exists()
    assert not result.failed
    assert result.table.read_bytes() == flown.read_bytes()


_ENDLESS = """
import sys
from pathlib import Path
from ptnsbc_sim.sweep.plan import SweepPlan
from ptnsbc_sim.sweep.runner import run
plan = SweepPlan.from_json(Path(sys.argv[1]).read_text())
run(plan, Path(sys.argv[2]), workers=2, progress=lambda done, total: print(done, flush=True))
"""


@pytest.mark.slow
def test_workers_end_with_a_sweep_that_is_killed(tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    plan.write_text(small(100_000).to_json())
    command = [sys.executable, "-c", _ENDLESS, str(plan), str(tmp_path / "sweep")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as sweep:
        assert [sweep.stdout.readline().strip() for _ in range(2)] == ["0", str(CHUNK_DRAWS)]
        workers = Path(f"/proc/{sweep.pid}/task/{sweep.pid}/children").read_text().split()
        watched = [os.pidfd_open(int(pid)) for pid in workers]
        sweep.kill()
    assert len(watched) == 2
    for descriptor in watched:
        assert select.select([descriptor], [], [], 30.0)[0], "a worker outlived its sweep"
        os.close(descriptor)


def test_chunks_cover_all_draws() -> None:
    plan = small(60)
    found = [k for index in range(chunk_count(plan)) for k in runner.chunk_draws(plan, index)]
    assert found == list(range(60))
