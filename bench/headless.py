"""Headless flight: ticks of the whole swarm per second, one process, one core."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bench.scenarios import grid, paper
from bench.session import Plan, cpu_seconds, take_turns
from bench.step import SVD, numpy_svd
from bench.table import Row, Target
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import fly

_SVD_CALLS = 5000


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    duration_s = plan.of(60.0, 10.0)
    flights = {5: paper(duration_s), 20: grid(20, 100, duration_s)}
    for scenario in (paper(0.1), grid(20, 100, 0.1)):
        fly(scenario)  # compiled or loaded before it counts
    runs: dict[str, Callable[[], float]] = {"svd": _svd_us}
    for size, scenario in flights.items():
        runs[str(size)] = _ticks_per_s(scenario)
    found = take_turns(runs, plan.of(7, 2))
    return [
        Row(
            f"headless flight, N = {size}",
            found[str(size)],
            "ticks/s",
            SVD,
            found["svd"],
            "µs",
            Target(20_000.0, at_least=True) if size == 5 else None,
        )
        for size in flights
    ]


def _svd_us() -> float:
    return 1e6 * cpu_seconds(numpy_svd, _SVD_CALLS)


def _ticks_per_s(scenario: Scenario) -> Callable[[], float]:
    return lambda: scenario.ticks / cpu_seconds(lambda: fly(scenario))
