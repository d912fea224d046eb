"""Pre-flight checks of the legs of a mission."""

from __future__ import annotations

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.deadline import leg_room
from ptnsbc_sim.scenario.mission.legs import FIRST, FormLeg
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings


def legs(scenario: Scenario) -> Findings:
    """Each leg against the limits of the vehicle, and the last one against the length of the flight."""
    found = scenario.legs
    ends = [*(one.begin_s for one in found[1:]), scenario.duration_s]
    for one, end_s in zip(found, ends, strict=False):
        if isinstance(one.leg, FormLeg) and one.number == FIRST:
            continue  # checks of the deadline are about it
        room = leg_room(scenario.file, one, end_s)
        yield Finding(
            ERROR if room.advice else INFO,
            f"mission.legs[{one.number - 1}]",
            room.found,
            room.limit,
            room.advice,
        )
    late = [one for one in found if one.due_s > scenario.duration_s]
    if late:
        yield Finding(
            WARNING,
            "timing.duration_s",
            f"{scenario.duration_s:g} s, leg {late[0].name} is due at {late[0].due_s:.2f} s",
            f">= {late[-1].due_s:.2f} s",
            "fly for longer, or begin the leg earlier",
        )
