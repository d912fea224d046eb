"""The needs of one choice in a scenario of its other keys: one table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ptnsbc_sim.scenario.mission.legs import ChangeLeg, SplitLeg, moves_shape
from ptnsbc_sim.scenario.mission.stream import SetpointTrajectory, takes_setpoints
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.problems import Problem, Problems

Conflict = Callable[[ScenarioFile], str | None]


class Condition(NamedTuple):
    """A state of other keys that a choice needs."""

    key: str
    expected: str
    conflict: Conflict  # the value that it has instead, "" where it takes too many words; None where it is as needed


class Requirement(NamedTuple):
    """A choice, and what it needs."""

    choice: str  # in words, for the page and the end of a message
    made: Callable[[ScenarioFile], Any]
    needs: tuple[Condition, ...]


def _word(key: str, expected: str) -> Condition:
    """The need of a key of `formation` to have a value."""

    def conflict(file: ScenarioFile) -> str | None:
        value = str(getattr(file.formation, key))
        return None if value == expected else value

    return Condition(f"formation.{key}", expected, conflict)


def _legs(file: ScenarioFile) -> Sequence[object]:
    return file.mission.legs if file.mission else ()


def _splits(file: ScenarioFile) -> bool:
    return any(isinstance(leg, SplitLeg) for leg in _legs(file))


def _rotates(file: ScenarioFile) -> bool:
    return any(isinstance(leg, ChangeLeg) and leg.rotation_rad != 0.0 for leg in _legs(file))


RELATIVE, PLANNED = _word("task", "relative_position"), _word("approach", "planned")
FIXED, WORLD = _word("assignment", "fixed"), _word("frame", "world")
WAITING = _word("vacancy", "wait")
NO_SIGHT = Condition(
    "formation.sight_m", "0", lambda f: f"{f.formation.sight_m:g}" if f.formation.sight_m else None
)
AT_REST = Condition(
    "formation",
    "a shape that does not move, without frame: heading, changes, or legs of kind take_off, change or split",
    lambda f: "" if f.formation.moves or moves_shape(f.mission) else None,
)
NO_CHANGES = Condition("formation.changes", "none", lambda f: "" if f.formation.changes else None)
NO_MISSION = Condition("mission", "none", lambda f: "legs" if f.mission else None)
NO_ROTATION = Condition(
    "mission.legs", "no leg of kind change with rotation_rad", lambda f: "" if _rotates(f) else None
)
KNOWN_PATH = Condition(
    "leader.trajectory.kind",
    "a trajectory that all UAVs know",
    lambda f: "stream" if isinstance(f.leader.trajectory, SetpointTrajectory) else None,
)
NO_LAW = Condition("law", "none", lambda f: f.law)
NO_TASK = Condition("plugins.task", "none", lambda f: f.plugins.task)
NO_CONTROLLER = Condition("plugins.controller", "none", lambda f: f.plugins.controller)

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
    Requirement("mission.legs", lambda f: f.mission, (PLANNED,)),
    Requirement(
        "a mission that changes the shape or splits", lambda f: moves_shape(f.mission), (RELATIVE,)
    ),
    Requirement("a leg of kind split", _splits, (WORLD, FIXED, NO_ROTATION)),
    Requirement(
        "a task of your own, which is told one place for each UAV",
        lambda f: f.plugins.task,
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


def requirement_problems(file: ScenarioFile) -> Problems:
    """The needs that are not met."""
    for requirement in REQUIREMENTS:
        for need in requirement.needs if requirement.made(file) else ():
            if (value := need.conflict(file)) is not None:
                yield Problem(need.key, value, f"{need.expected} beside {requirement.choice}")
