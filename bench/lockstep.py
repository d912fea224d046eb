"""Lock-step: steps per second of the whole fleet, beside two bare ping-pongs.

One passes message objects, as programs with rclpy do; the other passes bytes on that nobody looks into, and
shows what the machine could do at best.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.launch import Flown, bare, fleet
from bench.scenarios import paper
from bench.session import Plan, take_turns
from bench.table import Row, Target

_SHARE = Target(0.6, at_least=True, of_reference=True)


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
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
