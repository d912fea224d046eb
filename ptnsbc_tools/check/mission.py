"""Pre-flight checks of the legs of a mission."""

from __future__ import annotations

from dataclasses import replace

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.approach.deadline import leg_room
from ptnsbc_sim.scenario.mission.legs import FIRST, FormLeg, Word, leg_names
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings
from ptnsbc_tools.check.geometry import moving_spacing
from ptnsbc_tools.check.trajectory import trajectory


def legs(scenario: Scenario) -> Findings:
    """Each leg against the limits of the vehicle, and the last one against the length of the flight."""
    found = scenario.legs
    ends = [*(one.begin_s for one in found[1:]), scenario.timing.duration_s]
    for one, end_s in zip(found, ends, strict=False):
        if isinstance(one.leg, FormLeg) and one.number == FIRST:
            continue  # checks of the deadline are about it
        room = leg_room(scenario, one, end_s)
        yield Finding(
            ERROR if room.advice else INFO,
            f"mission.legs[{one.number - 1}]",
            room.found,
            room.limit,
            room.advice,
        )
    late = [one for one in found if one.due_s > scenario.timing.duration_s]
    if late:
        yield Finding(
            WARNING,
            "timing.duration_s",
            f"{scenario.timing.duration_s:g} s, leg {late[0].name} is due at {late[0].due_s:.2f} s",
            f">= {late[-1].due_s:.2f} s",
            "fly for longer, or begin the leg earlier",
        )


def words(scenario: Scenario) -> Findings:
    """The legs that wait for a word, as they are flown when each word is said as soon as the last leg is done."""
    said = _said(scenario)
    mission, first = said.mission, len(scenario.legs)
    if mission is None or first == len(said.legs):
        return
    yield Finding(
        INFO,
        f"mission.legs[{first}].on",
        f"{leg_names(mission)[first]} waits for a word",
        "without one neither it nor a leg after it is flown, headless as in a fleet",
        "",
    )
    for one in (legs, moving_spacing, trajectory):
        known = set(one(scenario))
        for finding in one(said):
            # In flight a leg that does not fit is refused: it may be said later, from another place.
            if finding not in known and (one is legs or finding.severity != INFO):
                severity = INFO if finding.severity == INFO else WARNING
                yield replace(finding, severity=severity, value=f"said at once, {finding.value}")


def _said(scenario: Scenario) -> Scenario:
    """The scenario after a word for each leg that waits for one, when the last leg is done."""
    mission = scenario.mission
    while mission is not None and scenario.legs[-1].number < len(mission.legs):
        last = scenario.legs[-1]
        scenario = scenario.with_words((*scenario.words, Word(last.number + 1, last.end_s)))
    return scenario
