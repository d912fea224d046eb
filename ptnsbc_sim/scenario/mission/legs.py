"""The legs of a mission: their blocks in a scenario file, and when each of them begins.

The leader's legs become one curve (route.py), those of the shape become `formation.changes`, and `land` a mode. So
every process flies legs by the same kernels as a trajectory and a shape without any.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta, timezone
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from ptnsbc_sim.scenario.fields import Block, Name, NotNegative, Number, Positive, UavId, Vec3
from ptnsbc_sim.scenario.mission import trajectories
from ptnsbc_sim.scenario.mission.shapes import Change, Reshaping, ShapeBlock
from ptnsbc_sim.scenario.mission.trajectories import TrajectoryBlock

CANCEL = 0
"""Number of the leg that a cancelled one gives way to."""

_MOST_LEGS = 200
_LATE_S = 1e-9  # by which the end of a leg may miss the begin of the next one
_UNIX = datetime(1970, 1, 1, tzinfo=timezone.utc)


def _utc(value: Any) -> Any:
    """A time in UTC, as text."""
    try:
        if isinstance(value, str) and value.endswith("Z"):
            datetime.fromisoformat(value)
            return value
    except ValueError:
        pass
    raise PydanticCustomError(
        "utc", "expected a time in UTC, such as 2026-11-22T12:00:05Z", {"value": value}
    )


Utc = Annotated[str, BeforeValidator(_utc)]
Span = Annotated[Number, Field(ge=0.1, le=1e6)]


class LegBlock(Block):
    """The keys that all kinds of legs have."""

    name: Name | None = None
    """Name, unique among the legs. Default: the kind and the number, such as `hold-3`."""
    at_s: Annotated[Number, Field(ge=0, le=1e6)] | None = None
    """Begin, after the first epoch. Default: when the last leg is done."""
    at: Utc | None = None
    """Begin as a time in UTC, such as `2026-11-22T12:00:05Z`, in place of `at_s`."""
    on: Literal["word"] | None = None
    """`word`: the leg waits for `ptnsbc mission start`, and begins without it at `at_s` or `at`, if one is given."""
    stay_s: NotNegative = 0.0
    """Time after which the leg is done, beyond its own."""


class FormLeg(LegBlock):
    """The first leg: the formation comes about."""

    kind: Literal["form"]
    """The formation comes about. A mission begins with it."""
    over_s: Span | None = None
    """Deadline, in place of `gains.formation.deadline_s`."""
    shape: ShapeBlock | None = None
    """Shape, in place of `formation.shape` and `formation.offsets_m`."""
    slots: Literal["fixed", "optimal"] | None = None
    """Assignment of the slots, in place of `formation.assignment`."""


class ChangeLeg(Reshaping, LegBlock):
    """Another shape, while the leader goes on."""

    kind: Literal["change"]
    """The formation changes its shape, while the leader goes on as in the leg before."""


class FollowLeg(LegBlock):
    """The leader joins a trajectory."""

    kind: Literal["follow"]
    """The leader joins a trajectory, whose time counts from the begin of the leg."""
    over_s: Span
    """Duration: by then the leader is on the trajectory. It stays on it until a later leg of the leader."""
    trajectory: TrajectoryBlock
    """The trajectory, one of the kinds of `leader.trajectory`:"""


class GoToLeg(LegBlock):
    """The leader goes to a place."""

    kind: Literal["go_to"]
    """The leader goes to a place, and the formation with it."""
    over_s: Span
    """Duration: by then the leader is there, at rest."""
    position_m: Vec3
    """The place."""
    yaw_rad: Number | None = None
    """Heading to turn to. Default: the present one."""


class HoldLeg(LegBlock):
    """The leader comes to rest."""

    kind: Literal["hold"]
    """The leader comes to rest, and the formation with it."""
    over_s: Span
    """Duration: by then it is at rest."""


class SplitLeg(LegBlock):
    """A part of the formation leaves with a trajectory of its own."""

    kind: Literal["split"]
    """A group of followers leaves with a trajectory of its own, while the leader goes on as in the leg before."""
    over_s: Span
    """Duration: by then the group is on its trajectory. It stays on it until it joins."""
    head: UavId
    """The follower that leads the group. The group is this UAV and all below it in `communication.tree`."""
    trajectory: TrajectoryBlock
    """Trajectory of the head, one of the kinds of `leader.trajectory`. Its time counts from the begin of the leg. The
    others of the group keep their places beside the head; heading is that of the leader."""


class JoinLeg(LegBlock):
    """The group that has left comes back."""

    kind: Literal["join"]
    """The group that has left comes back to its places beside the leader."""
    over_s: Span
    """Duration: by then every UAV is in its place."""


class LandLeg(LegBlock):
    """All UAVs descend over their places."""

    kind: Literal["land"]
    """Every UAV descends over its place at `gains.hold.land_speed_m_s`. No leg comes after it."""
    over_s: Span
    """Duration: by then every UAV is down."""
    ground_m: Number = 0.0
    """Height of the ground."""


AnyLeg = Annotated[
    FormLeg | ChangeLeg | FollowLeg | GoToLeg | HoldLeg | SplitLeg | JoinLeg | LandLeg,
    Field(discriminator="kind"),
]


class Mission(Block):
    """The task of a formation, leg by leg."""

    start: Utc | None = None
    """Time in UTC of the first epoch, for legs with `at`. In real time the fleet begins then; headless and in lock-step
    the flight counts from it."""
    cancel_s: Positive = 4.0
    """Time within which the leader comes to rest when a leg is cancelled."""
    legs: Annotated[tuple[AnyLeg, ...], Field(min_length=1, max_length=_MOST_LEGS)]
    """The legs, in their order:"""


_WORD = re.compile(r"mission (0|[1-9][0-9]{0,2})", re.ASCII)


class Word(NamedTuple):
    """An operator's word in flight."""

    number: int  # of the leg to begin, from 1; CANCEL
    at_s: float  # from when it counts [s since the first epoch]


class ScheduledLeg(NamedTuple):
    """A leg and its times [s] since the first epoch."""

    number: int  # from 1; CANCEL for the one that a cancelled leg gives way to
    name: str
    leg: Any  # its block
    begin_s: float
    due_s: float  # by which it has to be met
    end_s: float  # when it is done


def word_text(number: int) -> str:
    """The announcement of the leader when a leg is to begin, or the present one to be cancelled."""
    return f"mission {number}"


def number_of(text: str) -> int | None:
    """Number of the leg that an announcement begins, CANCEL; None for one of another kind."""
    found = _WORD.fullmatch(text)
    return None if found is None else int(found[1])


def utc_ns(text: str) -> int:
    """Nanoseconds since 1970 of a time in UTC."""
    return (datetime.fromisoformat(text) - _UNIX) // timedelta(microseconds=1) * 1000


def seconds_to_start(mission: Mission | None, now_ns: int) -> float:
    """The time [s] left until a mission is to begin by the wall clock, 0 when it names no time."""
    if mission is None or mission.start is None:
        return 0.0
    return max((utc_ns(mission.start) - now_ns) * 1e-9, 0.0)


def leg_names(mission: Mission) -> list[str]:
    """The name of every leg."""
    return [leg.name or f"{leg.kind}-{number}" for number, leg in enumerate(mission.legs, 1)]


def begin_of(mission: Mission, leg: Any) -> float | None:
    """The latest begin of a leg [s]; None: when the last one is done, or when it is said."""
    if leg.at is not None and mission.start is not None:
        return (utc_ns(leg.at) - utc_ns(mission.start)) * 1e-9
    return None if leg.at_s is None else float(leg.at_s)


def schedule(
    mission: Mission, deadline_s: float, words: Sequence[Word] = ()
) -> tuple[ScheduledLeg, ...]:
    """The legs that begin, in their order.

    Args:
        mission: the legs.
        deadline_s: of the formation.
        words: what was said in flight; a word drops what would begin after it.
    """
    found = list(_run(mission, deadline_s, 0, 0.0))
    for word in words:
        found = [one for one in found if one.begin_s < word.at_s]
        if word.number == CANCEL:
            due_s = word.at_s + mission.cancel_s
            hold = HoldLeg(kind="hold", over_s=max(mission.cancel_s, 0.1))
            found.append(ScheduledLeg(CANCEL, "cancelled", hold, word.at_s, due_s, due_s))
        else:
            found.extend(_run(mission, deadline_s, word.number - 1, word.at_s))
    return tuple(found)


def _run(mission: Mission, deadline_s: float, first: int, begin_s: float) -> Iterator[ScheduledLeg]:
    """The legs from number `first` (from 0) on, until one that waits for a word."""
    end_s, names = begin_s, leg_names(mission)
    for index in range(first, len(mission.legs)):
        leg = mission.legs[index]
        at_s = begin_of(mission, leg) if index > first else begin_s
        if leg.on == "word" and at_s is None:
            return
        begin_s = end_s if at_s is None else max(at_s, end_s)
        due_s = begin_s + (deadline_s if isinstance(leg, FormLeg) else leg.over_s)
        end_s = due_s + leg.stay_s
        yield ScheduledLeg(index + 1, names[index], leg, begin_s, due_s, end_s)


def moves_shape(mission: Mission | None) -> bool:
    """True if a leg of the mission moves places beside the leader."""
    return any(isinstance(leg, ChangeLeg | SplitLeg) for leg in (mission.legs if mission else ()))


def scheduled_changes(mission: Mission, legs: Sequence[ScheduledLeg]) -> tuple[Change, ...]:
    """The legs that change the shape, as changes at their times.

    The first one changes nothing. Where a leg may change the shape later, on a word, it is from the first epoch on one
    that moves: it does not matter when a UAV hears of that word.
    """
    keys = Reshaping.model_fields
    nothing = Change.model_construct(at_s=0.0, over_s=0.1)
    first = (nothing,) if moves_shape(mission) else ()
    return first + tuple(
        Change.model_construct(at_s=one.begin_s, **{key: getattr(one.leg, key) for key in keys})
        for one in legs
        if isinstance(one.leg, ChangeLeg)
    )


def leader_legs(legs: Sequence[ScheduledLeg]) -> tuple[ScheduledLeg, ...]:
    """The legs that move the leader."""
    return tuple(one for one in legs if isinstance(one.leg, FollowLeg | GoToLeg | HoldLeg))


_SAME_PATH = ((ChangeLeg,), (FollowLeg, GoToLeg, HoldLeg), (SplitLeg, JoinLeg))
"""The kinds of legs that move the same places: one of them takes the place of another one."""


def is_cut_short(legs: Sequence[ScheduledLeg], one: ScheduledLeg) -> bool:
    """True if a later leg took the place of this one before it was due: an operator said so."""
    kinds = next((kinds for kinds in _SAME_PATH if isinstance(one.leg, kinds)), ())
    stops = isinstance(one.leg, SplitLeg)  # a group that has left comes to rest with the leader
    return any(
        one.begin_s < later.begin_s < one.due_s
        and (isinstance(later.leg, kinds) or (stops and later.number == CANCEL))
        for later in legs
    )


def landing_s(legs: Sequence[ScheduledLeg]) -> float | None:
    """The begin of the landing [s]; None without one."""
    return next((one.begin_s for one in legs if isinstance(one.leg, LandLeg)), None)


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
        if leg.at is not None and mission.start is None:
            yield f"{where}.at: expected mission.start, from which the flight counts"
    for before, one in pairwise(_run(mission, deadline_s, 0, 0.0)):
        at_s = begin_of(mission, one.leg)
        if at_s is not None and at_s < before.end_s - _LATE_S:
            key = "at" if one.leg.at is not None else "at_s"
            yield (
                f"mission.legs[{one.number - 1}].{key}: {at_s:g} s: expected at least {before.end_s:g} s, "
                "when the leg before is done"
            )


def _kinds(mission: Mission, file: Any) -> Iterator[str]:
    followers = [uav.id for uav in file.uavs if uav.id != file.leader.id]
    for index, leg in enumerate(mission.legs):
        where = f"mission.legs[{index}]"
        if index == 0 and not isinstance(leg, FormLeg):
            yield f"{where}.kind: {leg.kind}: expected form, with which a mission begins"
        if index > 0 and isinstance(leg, FormLeg):
            yield f"{where}.kind: form: expected change, with which a later leg takes another shape"
        if index == 0 and (leg.at_s or leg.at is not None or leg.on is not None):
            yield f"{where}: expected no at_s, at or on: the first leg begins with the first epoch"
        if isinstance(leg, LandLeg) and index + 1 < len(mission.legs):
            yield f"{where}.kind: land: expected no leg after it"
        for problem in _content(leg, followers):
            yield f"{where}.{problem}"
        if isinstance(leg, SplitLeg):
            for problem in _beside_split(mission, file.formation):
                yield f"{where}.kind: split: {problem}"


def _content(leg: Any, followers: list[int]) -> Iterator[str]:
    """The problems of a leg by itself."""
    if isinstance(leg, FollowLeg | SplitLeg):
        for problem in trajectories.problems(leg.trajectory):
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
