"""Sweeps: 1000 flights of paper_5_free by two cores, drawn, flown, judged and written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.session import Plan
from bench.table import Row, Target
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import SweepPlan, drawn_scenario, plan_of
from ptnsbc_sim.sweep.runner import run
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of

_CORES = 2
_FLIGHT_S = 10.0
_LOOK_S = 1.0  # between two looks at the memory
_TICKS = 5 * 1000  # of all UAVs in one flight


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    runs, most = plan.of(1000, 100), plan.of(10_000, 200)
    _swept(50)  # compiled or loaded before it counts
    found = [_swept(runs) for _ in range(plan.of(3, 1))]
    wall_s = [one["wall_s"] for one in found]
    per_s = [runs * _TICKS / spent_s for spent_s in wall_s]
    loop_ms, verdict_ms = _judged_ms(plan.of(100, 20))
    memory_mb = [_swept(most)["memory_mb"]]
    return [
        Row(f"{runs} flights of 10 s, N = 5, 2 workers", wall_s, "s", target=Target(20.0)),
        Row("the same", per_s, "UAV-ticks/s", target=Target(600_000.0, at_least=True)),
        Row("the same, CPU time per flight", [one["cpu_s"] / runs * 1e3 for one in found], "ms"),
        Row("CPU time of a verdict", verdict_ms, "ms", "its loop", loop_ms, "", Target(1.5)),
        Row(f"memory of {most} flights, all processes", memory_mb, "MB", target=Target(1000.0)),
    ]


def _sweep(runs: int) -> SweepPlan:
    scenario = load_scenario("paper_5_free", {"timing.duration_s": _FLIGHT_S})
    return plan_of(scenario, runs, starts=parse_starts("near:0.3"))


def _judged_ms(runs: int) -> Iterator[tuple[float, ...]]:
    """CPU times of the loop and of the verdict of each flight of a sweep, the first one apart [ms]."""
    plan, room = _sweep(runs + 1), None
    spent_ms = []
    for k in range(runs + 1):
        scenario, _ = drawn_scenario(plan, k)
        began_s = time.thread_time()
        room = fly(scenario, room=room)
        flown_s = time.thread_time()
        verdict_on(recording_of(room))
        spent_ms.append((1e3 * (flown_s - began_s), 1e3 * (time.thread_time() - flown_s)))
    return zip(*spent_ms[1:], strict=True)


def _swept(runs: int) -> dict[str, float]:
    """A sweep in a process of its own, on two cores."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "bench.sweep", str(runs), str(Path(folder) / "sweep")]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    return dict(json.loads(done.stdout))


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
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:_CORES])
    memory, looked_s = 0.0, 0.0

    def look(done: int, total: int) -> None:
        nonlocal memory, looked_s
        if time.perf_counter() > looked_s + _LOOK_S:  # a look takes 8 ms from the flights
            memory, looked_s = max(memory, _memory_mb()), time.perf_counter()

    began = time.perf_counter()
    run(_sweep(runs), folder, workers=_CORES, progress=look)
    wall_s, spent = time.perf_counter() - began, os.times()
    cpu_s = spent.user + spent.system + spent.children_user + spent.children_system
    print(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s, "memory_mb": memory}))


if __name__ == "__main__":
    _main(int(sys.argv[1]), Path(sys.argv[2]))
