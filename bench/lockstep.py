"""Lock-step: steps per second of the whole fleet, beside two bare ping-pongs; large fleets by 25 UAVs a process.

One passes message objects, as programs with rclpy do; the other passes bytes on that nobody looks into, and
shows what the machine could do at best.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench.launch import Flown, bare, fleet
from bench.scenarios import grid, paper
from bench.session import Plan, print_progress, take_turns
from bench.table import Row, Target

_SHARE = Target(0.6, at_least=True, of_reference=True)
_LARGE_HZ, _IN_PROCESS = 50, 25
_LARGE = {50: Target(0.5, at_least=True), 100: Target(0.2, at_least=True)}


def measure(plan: Plan) -> Iterator[Row]:
    """Rows of this section, the large fleets first."""
    for size, target in _LARGE.items():
        yield from _large(size, target, plan)
    yield from _small(plan)


def _large(size: int, target: Target, plan: Plan) -> Iterator[Row]:
    """A fleet by `ptnsbc fleet --processes K`."""
    processes = size // _IN_PROCESS
    name = f"lock-step, N = {size} in {processes} processes, {_LARGE_HZ} Hz"
    print_progress(name)
    scenario = grid(size, _LARGE_HZ, plan.of(10.0, 3.0))
    flown = fleet(scenario, lockstep=True, bag=False, processes=processes)
    speed = flown.steps_per_s / _LARGE_HZ
    yield Row(f"{name}: speed", [speed], "× real time", target=target)
    yield Row(f"{name}: memory of a process", [flown.usage["uav"].rss_mb], "MB")


def _small(plan: Plan) -> list[Row]:
    scenario = paper(plan.of(10.0, 3.0))
    found = take_turns(
        {
            "bare ping-pong": lambda: bare(scenario, lockstep=True, bag=False, typed=True),
            "bare bytes": lambda: bare(scenario, lockstep=True, bag=False),
            "fleet": lambda: fleet(scenario, lockstep=True, bag=False),
            "bare bytes with a listener to all": lambda: bare(scenario, lockstep=True, bag=True),
            "fleet with a bag": lambda: fleet(scenario, lockstep=True, bag=True),
        },
        plan.of(3, 1),
        "lock-step, N = 5",
    )
    return [
        _row("", found["fleet"], found["bare ping-pong"], "bare ping-pong, message objects"),
        _row("", found["fleet"], found["bare bytes"], "bare ping-pong, bytes not decoded"),
        _row(
            ", recorded",
            found["fleet with a bag"],
            found["bare bytes with a listener to all"],
            "bare bytes, heard by one more",
        ),
    ]


def _row(what: str, own: list[Flown], other: list[Flown], name: str) -> Row:
    rates, references = ([flown.steps_per_s for flown in each] for each in (own, other))
    return Row(f"lock-step, N = 5{what}", rates, "steps/s", name, references, target=_SHARE)
