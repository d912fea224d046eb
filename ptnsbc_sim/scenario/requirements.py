"""The needs of one choice in a scenario of its other keys: one table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ptnsbc_sim.scenario.mission.legs import ChangeLeg, SplitLeg, moves_shape
from ptnsbc_sim.scenario.mission.stream import takes_setpoints
from ptnsbc_sim.scenario.model import ScenarioFile

Test = Callable[[ScenarioFile], Any]


class Condition(NamedTuple):
    """A state of other keys that a choice needs."""

    key: str
    expected: str
    value: Test  # as it is, for the message; "" where it takes too many words
    holds: Test


class Requirement(NamedTuple):
    """A choice, and what it needs."""

    choice: str  # in words, for the page and the end of a message
    made: Test
    needs: tuple[Condition, ...]


def _word(key: str, expected: str) -> Condition:
    """The need of a key of `formation` to have a value."""

    def value(file: ScenarioFile) -> Any:
        return getattr(file.formation, key)

    return Condition(f"formation.{key}", expected, value, lambda file: f"{value(file)}" == expected)


def _splits(file: ScenarioFile) -> bool:
    return any(isinstance(leg, SplitLeg) for leg in (file.mission.legs if file.mission else ()))


def _rotates(file: ScenarioFile) -> bool:
    legs = file.mission.legs if file.mission else ()
    return any(isinstance(leg, ChangeLeg) and leg.rotation_rad for leg in legs)


RELATIVE, PLANNED = _word("task", "relative_position"), _word("approach", "planned")
FIXED, WORLD, WAITING = (
    _word("assignment", "fixed"),
    _word("frame", "world"),
    _word("vacancy", "wait"),
)
NO_SIGHT = Condition(
    "formation.sight_m",
    "0",
    lambda f: f"{f.formation.sight_m:g}",
    lambda f: f.formation.sight_m == 0.0,
)
AT_REST = Condition(
    "formation",
    "a shape that does not move, without frame: heading, changes, or legs of kind take_off, change or split",
    lambda f: "",
    lambda f: not (f.formation.moves or moves_shape(f.mission)),
)
NO_CHANGES = Condition("formation.changes", "none", lambda f: "", lambda f: not f.formation.changes)
NO_MISSION = Condition("mission", "none", lambda f: "legs", lambda f: f.mission is None)
NO_ROTATION = Condition(
    "mission.legs",
    "no leg of kind change with rotation_rad",
    lambda f: "",
    lambda f: not _rotates(f),
)
KNOWN_PATH = Condition(
    "leader.trajectory.kind",
    "a trajectory that all UAVs know",
    lambda f: "stream",
    lambda f: f.leader.trajectory.kind != "stream",
)
NO_LAW = Condition("law", "none", lambda f: f.law, lambda f: f.law is None)
NO_TASK = Condition(
    "plugins.task", "none", lambda f: f.plugins.task, lambda f: f.plugins.task is None
)
NO_CONTROLLER = Condition(
    "plugins.controller",
    "none",
    lambda f: f.plugins.controller,
    lambda f: f.plugins.controller is None,
)

REQUIREMENTS = (
    Requirement(
        "communication.parents",
        lambda f: f.communication.parents,
        (RELATIVE, WAITING, FIXED, AT_REST, NO_SIGHT, NO_LAW, NO_TASK),
    ),
    Requirement(
        "a leader that follows setpoints from a topic",
        lambda f: takes_setpoints(f.leader.trajectory),
        (WORLD, FIXED, NO_MISSION),  # each of them needs the whole trajectory, which nobody knows
    ),
    Requirement("formation.turn_rad", lambda f: f.formation.turn_rad, (FIXED, PLANNED)),
    Requirement(
        "a shape that moves (formation.frame: heading, formation.changes)",
        lambda f: f.formation.moves,
        (RELATIVE, PLANNED),
    ),
    Requirement(
        "mission.legs, of which one of kind change does the same",
        lambda f: f.mission,
        (NO_CHANGES,),
    ),
    Requirement("mission.legs", lambda f: f.mission, (PLANNED, NO_LAW)),
    Requirement(
        "a mission that changes the shape or splits", lambda f: moves_shape(f.mission), (RELATIVE,)
    ),
    Requirement("a leg of kind split", _splits, (WORLD, FIXED, NO_ROTATION)),
    Requirement(
        "a law or a task of your own, which is told one place for each UAV",
        lambda f: f.law or f.plugins.task,
        (FIXED, AT_REST),
    ),
    Requirement("a law, which flies the followers without a task", lambda f: f.law, (NO_TASK,)),
    Requirement(
        "formation.vacancy: keep or close_up",
        lambda f: f.formation.reconfigures,
        (PLANNED, FIXED, AT_REST, NO_SIGHT, KNOWN_PATH, NO_LAW, NO_TASK, NO_CONTROLLER),
    ),
)
"""Every choice that excludes another one."""


def requirement_problems(file: ScenarioFile) -> Iterator[str]:
    """The needs that are not met, as `key: value: expectation`."""
    for requirement in REQUIREMENTS:
        if requirement.made(file):
            for need in requirement.needs:
                if not need.holds(file):
                    value = f"{need.value(file)}: " if need.value(file) else ""
                    yield f"{need.key}: {value}expected {need.expected} beside {requirement.choice}"
