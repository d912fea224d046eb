"""Sweeps: 1000 flights of paper_5_free by two cores, drawn, flown, judged and written."""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

from bench.session import Plan, print_progress
from bench.table import Row, Target
from ptnsbc_sim.sweep.plan import SweepPlan

_CORES = 2
_FLIGHT_S = 10.0
_LOOK_S = 1.0  # between two looks at the memory
_TICKS = 5 * 1000  # of all UAVs in one flight
_LOOPS: dict[str, Callable[..., None]] = {}  # compiled here, and there after a fork


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        print_progress("sweep: pyarrow is not installed, skipped")
        return []
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
        _processes_and_threads(plan),
    ]


def _processes_and_threads(plan: Plan) -> Row:
    """The same flights by two forked processes and by two threads, whose loops hold no interpreter lock."""
    import numba

    from ptnsbc_sim.scenario import load_scenario
    from ptnsbc_sim.swarm import _fly
    from ptnsbc_sim.sweep import parse_starts
    from ptnsbc_sim.sweep.plan import plan_of

    scenario = load_scenario("paper_5_free", {"timing.duration_s": _FLIGHT_S})
    draws = plan.of(400, 50)
    sweep = plan_of(scenario, draws, starts=parse_starts("near:0.3"))
    print_progress("sweep: the loop once more, compiled without the interpreter lock")
    _LOOPS["locked"] = _fly
    _LOOPS["free"] = numba.njit(error_model="numpy", nogil=True)(_fly.py_func)  # type: ignore[attr-defined]
    chunks = [range(first, first + 25) for first in range(0, draws, 25)]

    def seconds(pool: Executor, loop: str) -> float:
        began = time.perf_counter()
        with pool:
            list(pool.map(_judged, [sweep] * len(chunks), chunks, [loop] * len(chunks)))
        return time.perf_counter() - began

    forked = multiprocessing.get_context("fork")
    for loop in _LOOPS:
        _judged(sweep, range(1), loop)  # compiled or loaded before it counts
    runs = range(plan.of(3, 1))
    pairs = [
        (
            seconds(ProcessPoolExecutor(_CORES, mp_context=forked), "locked"),
            seconds(ThreadPoolExecutor(_CORES), "free"),
        )
        for _ in runs
    ]
    return Row(
        f"{draws} flights, {_CORES} processes",
        [processes for processes, _ in pairs],
        "s",
        reference=f"{_CORES} threads",
        references=[threads for _, threads in pairs],
    )


def _judged(plan: SweepPlan, draws: range, loop: str) -> int:
    """Fly and judge some draws of a plan; how many rows they have."""
    from ptnsbc_sim.swarm import flown
    from ptnsbc_sim.sweep.plan import drawn_scenario
    from ptnsbc_sim.sweep.rows import rows_of
    from ptnsbc_sim.verdict.headless import recording_of

    room, rows = None, 0
    for k in draws:
        scenario, _ = drawn_scenario(plan, k)
        flight = flown(scenario, _LOOPS[loop], room=room)
        rows += len(rows_of(k, scenario, recording_of(flight)))
        room = flight
    return rows


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
    from ptnsbc_sim.sweep import parse_starts, run
    from ptnsbc_sim.sweep.plan import plan_of

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
