"""The problems of the legs of a mission in a whole scenario file, before they are scheduled."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

from ptnsbc_sim.scenario.mission import curves
from ptnsbc_sim.scenario.mission.legs import (
    ChangeLeg,
    FollowLeg,
    FormLeg,
    JoinLeg,
    LandLeg,
    Mission,
    SplitLeg,
    TakeOffLeg,
    begin_of,
    leg_names,
    moves_shape,
    schedule,
    takes_off,
)
from ptnsbc_sim.scenario.mission.utc import utc_time

_LATE_S = 1e-9  # by which the end of a leg may miss the begin of the next one


def problems(file: Any) -> Iterator[str]:
    """The problems of the mission of a whole scenario file, before it is scheduled."""
    mission = file.mission
    if mission is None:
        return
    if file.formation.changes:
        yield "formation.changes: expected none beside mission.legs: a leg of kind change does the same"
    if file.formation.approach != "planned":
        yield f"formation.approach: {file.formation.approach}: expected planned for a mission"
    if moves_shape(mission) and file.formation.task != "relative_position":
        yield (
            f"formation.task: {file.formation.task}: expected relative_position for a mission that changes "
            "the shape or splits"
        )
    if file.law is not None:
        yield f"law: {file.law}: expected none beside a mission"
    yield from _begins(mission, file.gains.formation.deadline_s)
    yield from _kinds(mission, file)


def _begins(mission: Mission, deadline_s: float) -> Iterator[str]:
    names = leg_names(mission)
    for index, leg in enumerate(mission.legs):
        where = f"mission.legs[{index}]"
        if names[index] in names[:index]:
            yield f"{where}.name: {names[index]}: expected a name that no other leg has"
        if leg.at is not None and leg.at_s is not None:
            yield f"{where}.at: expected either at or at_s"
        if leg.at is not None:
            yield from _counts_from(mission.start, leg.at, where)
    for before, one in pairwise(schedule(mission, deadline_s)):
        at_s = begin_of(mission, one.leg)
        if at_s is not None and at_s < before.end_s - _LATE_S:
            key = "at" if one.leg.at is not None else "at_s"
            yield (
                f"mission.legs[{one.number - 1}].{key}: {at_s:g} s: expected at least {before.end_s:g} s, "
                "when the leg before is done"
            )


def _counts_from(start: str | None, at: str, where: str) -> Iterator[str]:
    if start is None:
        yield f"{where}.at: expected mission.start, from which the flight counts"
    elif not utc_time(at).follows(utc_time(start)):
        yield (
            f"{where}.at: {at}: expected a time that recurs as mission.start, {start}, does, or more often; "
            "a date where that is one"
        )


def _kinds(mission: Mission, file: Any) -> Iterator[str]:
    followers = [uav.id for uav in file.uavs if uav.id != file.leader.id]
    for index, leg in enumerate(mission.legs):
        where = f"mission.legs[{index}]"
        if problem := _order(mission, index):
            yield f"{where}.kind: {leg.kind}: {problem}"
        if index == 0 and (leg.at_s or leg.at is not None or leg.on is not None):
            yield f"{where}: expected no at_s, at or on: the first leg begins with the first epoch"
        if isinstance(leg, LandLeg) and index + 1 < len(mission.legs):
            yield f"{where}.kind: land: expected no leg after it"
        for problem in _content(leg, followers):
            yield f"{where}.{problem}"
        if isinstance(leg, SplitLeg):
            for problem in _beside_split(mission, file.formation):
                yield f"{where}.kind: split: {problem}"


def _order(mission: Mission, index: int) -> str:
    """The reason why a leg may not stand where it stands; empty when it may."""
    leg, rises = mission.legs[index], takes_off(mission)
    if index == 0:
        allowed = isinstance(leg, FormLeg | TakeOffLeg)
        return "" if allowed else "expected form or take_off, with which a mission begins"
    if isinstance(leg, TakeOffLeg):
        return "expected no take_off after the first leg: UAVs that fly go_to a height"
    if index == 1 and rises:
        return "" if isinstance(leg, FormLeg) else "expected form, which follows take_off"
    if isinstance(leg, FormLeg):
        return "expected change, with which a later leg takes another shape"
    return _apart(mission, index)


def _apart(mission: Mission, index: int) -> str:
    """The same of a group that leaves or comes back, which legs that wait for a word do too."""
    leg = mission.legs[index]
    before = [one for one in mission.legs[:index] if isinstance(one, SplitLeg | JoinLeg)]
    apart = bool(before) and isinstance(before[-1], SplitLeg)
    if isinstance(leg, SplitLeg) and apart:
        return "expected a leg of kind join before it"
    if isinstance(leg, JoinLeg) and not apart:
        return "expected a leg of kind split before it"
    return ""


def _content(leg: Any, followers: list[int]) -> Iterator[str]:
    """The problems of a leg by itself."""
    if isinstance(leg, FollowLeg | SplitLeg) or getattr(leg, "trajectory", None) is not None:
        for problem in curves.problems(leg.trajectory):
            yield f"trajectory.{problem}"
    if isinstance(leg, SplitLeg) and leg.head not in followers:
        yield f"head: {leg.head}: expected one of the followers {followers}"
    if isinstance(leg, ChangeLeg):
        for uav in sorted(set(followers).symmetric_difference(leg.offsets_m or followers)):
            yield f"offsets_m.{uav}: expected an offset of each follower {followers}, and of no other UAV"


def _beside_split(mission: Mission, formation: Any) -> Iterator[str]:
    """The parts that a mission with a leg of kind split may not have."""
    turned = any(isinstance(leg, ChangeLeg) and leg.rotation_rad for leg in mission.legs)
    expected = (
        (formation.frame == "world", "formation.frame: world"),
        (formation.assignment == "fixed", "formation.assignment: fixed"),
        (not turned, "no leg of kind change with rotation_rad"),
    )
    for holds, what in expected:
        if not holds:
            yield f"expected {what}"
