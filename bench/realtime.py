"""Real time: missed ticks, latency, CPU and memory per process, beside a bare fleet on timers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from bench.launch import Flown, bare, fleet
from bench.scenarios import grid, paper
from bench.session import Plan, take_turns
from bench.table import Row, Target

_BARE = "bare"
_MISSED = Target(1.0)


class Case(NamedTuple):
    """One size of fleet."""

    size: int
    control_hz: int
    bag: bool
    target: bool = False
    processes: int | None = None  # for the UAVs; one for each by default

    @property
    def name(self) -> str:
        """Like `N = 20, 50 Hz`."""
        shared = f", {self.processes} processes" if self.processes else ""
        return f"N = {self.size}, {self.control_hz} Hz{shared}{', recorded' if self.bag else ''}"


CASES = (
    Case(5, 100, bag=False, target=True),
    Case(5, 100, bag=True, target=True),
    Case(10, 50, bag=False),
    Case(20, 50, bag=False, target=True),
    Case(20, 50, bag=True),
    Case(20, 100, bag=False, target=True),
    Case(20, 100, bag=False, target=True, processes=4),
)


def measure(plan: Plan) -> Iterator[Row]:
    """Rows of this section, one case after the other: minutes are not lost with the last of them."""
    for case in plan.of(CASES, CASES[:1]):
        yield from _rows(case, plan)


def _rows(case: Case, plan: Plan) -> list[Row]:
    duration_s = plan.of(15.0, 5.0)
    scenario = paper(duration_s) if case.size == 5 else grid(case.size, case.control_hz, duration_s)
    found = take_turns(
        {
            "bare fleet": lambda: bare(scenario, lockstep=False, bag=case.bag),
            "fleet": lambda: fleet(
                scenario, lockstep=False, bag=case.bag, processes=case.processes
            ),
        },
        plan.of(2, 1),
        f"real time, {case.name}",
    )

    def row(what: str, unit: str, figure: Callable[[Flown], float], limit: bool = False) -> Row:
        return Row(
            f"{case.name}: {what}",
            [figure(flown) for flown in found["fleet"]],
            unit,
            _BARE,
            [figure(flown) for flown in found["bare fleet"]],
            target=_MISSED if limit else None,
        )

    rows = [
        row("missed ticks", "%", lambda flown: flown.missed_percent, case.target),
        row("latency, median", "ms", lambda flown: flown.latency_p50_ms),
        row("latency, 99 %", "ms", lambda flown: flown.latency_p99_ms),
    ]
    for role in ("uav", "sim", "recorder") if case.bag else ("uav", "sim"):
        process = _PROCESS[role]
        rows.append(row(f"CPU of {process}", "cores", _usage(role, "cores")))
        rows.append(row(f"memory of {process}", "MB", _usage(role, "rss_mb")))
        rows.append(row(f"memory of {process}, its share", "MB", _usage(role, "pss_mb")))
    if case.bag:
        lost = [flown.lost_percent for flown in found["fleet"]]
        rows.append(Row(f"{case.name}: odometry missing in the bag", lost, "%"))
    return rows


_PROCESS = {"uav": "one UAV", "sim": "the sim", "recorder": "the recorder"}


def _usage(role: str, what: str) -> Callable[[Flown], float]:
    return lambda flown: float(getattr(flown.usage[role], what))
