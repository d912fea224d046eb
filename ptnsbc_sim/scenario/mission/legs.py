"""The legs of a mission: their blocks in a scenario file, when each of them begins, and what does not fit.

The leader's legs become one curve (route.py), those of the shape become `formation.changes`, and `land` a mode. So
every process flies legs by the same kernels as a trajectory and a shape without any. A day of UTC has 86 400 s here,
as in POSIX: leap seconds do not count.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from ptnsbc_core.nanoseconds import SECOND_NS
from ptnsbc_sim.scenario.fields import Block, Name, NotNegative, Number, Positive, UavId, Vec3
from ptnsbc_sim.scenario.mission.shapes import Change, Reshaping, ShapeBlock
from ptnsbc_sim.scenario.mission.trajectories import TrajectoryBlock

_UNIX = datetime(1970, 1, 1, tzinfo=timezone.utc)
_DATE = TypeAdapter(datetime)  # datetime.fromisoformat knows no Z before Python 3.11
_TIME_OF_DAY = re.compile(r"(\*|[01]\d|2[0-3]):(\*|[0-5]\d):([0-5]\d)(?:\.(\d{1,6}))?Z", re.ASCII)


class UtcTime(NamedTuple):
    """A time in UTC [ns]."""

    first_ns: int  # since 1970; of one that recurs, the first one after 1970 began
    period_ns: int  # 0: it does not recur

    def next_ns(self, now_ns: int) -> int:
        """The instant; of a time that recurs, the first one from `now_ns` on."""
        if self.period_ns == 0:
            return self.first_ns
        return now_ns + (self.first_ns - now_ns) % self.period_ns

    def after(self, start: UtcTime) -> int:
        """The time [ns] from `start` to the first one after it; negative for one instant before another."""
        apart_ns = self.first_ns - start.first_ns
        return apart_ns % self.period_ns if self.period_ns else apart_ns

    def follows(self, start: UtcTime) -> bool:
        """True if the time from `start` to the first one after it is always the same."""
        if self.period_ns == 0:
            return start.period_ns == 0
        return start.period_ns % self.period_ns == 0


def utc_time(text: str) -> UtcTime:
    """The time that a text names: `2026-11-22T12:00:05Z`, `12:00:05Z`, `*:00:05Z`, `*:*:05Z`.

    Raises:
        ValueError: a text of another form.
    """
    match = _TIME_OF_DAY.fullmatch(text)
    if match is None:
        if not text.endswith("Z"):
            raise ValueError(text)
        since = _DATE.validate_python(text) - _UNIX
        return UtcTime(since // timedelta(microseconds=1) * 1000, 0)
    hour, minute, second, fraction = match.groups()
    if minute == "*" != hour:
        raise ValueError(text)
    whole_s, period_s = int(second), 60
    if minute != "*":
        whole_s, period_s = whole_s + 60 * int(minute), 3600
    if hour != "*":
        whole_s, period_s = whole_s + 3600 * int(hour), 86_400
    return UtcTime(whole_s * SECOND_NS + int((fraction or "").ljust(9, "0")), period_s * SECOND_NS)


def _utc(value: Any) -> Any:
    """A time in UTC, as text."""
    try:
        if isinstance(value, str):
            utc_time(value)
            return value
    except (ValueError, ValidationError):
        pass
    raise PydanticCustomError(
        "utc",
        "expected a time in UTC, such as 2026-11-22T12:00:05Z, or 12:00:05Z for one of every day, "
        "*:00:05Z of every hour, *:*:05Z of every minute",
        {"value": value},
    )


Utc = Annotated[str, BeforeValidator(_utc)]


Places = Mapping[int, tuple[float, float, float]]
"""Offsets [m] from the leader, by UAV."""

CANCEL = 0
"""Number of the leg that a cancelled one gives way to."""

FIRST = 1
"""Number of the leg that begins with the first epoch, and whose deadline is that of the formation."""

_MOST_LEGS = 200


Span = Annotated[Number, Field(ge=0.1, le=1e6)]


class LegBlock(Block):
    """The keys that all kinds of legs have."""

    name: Name | None = None
    """Name, unique among the legs. Default: the kind and the number, such as `hold-3`."""
    at_s: Annotated[Number, Field(ge=0, le=1e6)] | None = None
    """Begin, after the first epoch. Default: when the last leg is done."""
    at: Utc | None = None
    """Begin as a time in UTC, such as `2026-11-22T12:00:05Z`, in place of `at_s`. With a `mission.start` that recurs it
    recurs too, as often or more often: then it is the first such time after the start."""
    on: Literal["word"] | None = None
    """`word`: the leg waits for `ptnsbc mission start`, and begins without it at `at_s` or `at`, if one is given."""
    stay_s: NotNegative = 0.0
    """Time after which the leg is done, beyond its own."""


class TakeOffLeg(LegBlock):
    """Every UAV rises over its start by one time profile. A mission may begin with it; `form` comes next."""

    kind: Literal["take_off"]
    over_s: Span
    """Duration: by then every UAV is at the height, at rest."""
    height_m: Number
    """Height to rise to."""
    from_m: Number | None = None
    """Height from which the UAVs rise. Default: that of each start; of real vehicles `mavlink.takeoff_height_m`, at
    which their own take-off ends."""


class FormLeg(LegBlock):
    """The formation comes about. A mission begins with it, or with `take_off` before it."""

    kind: Literal["form"]
    over_s: Span | None = None
    """Deadline, in place of `gains.formation.deadline_s`."""
    shape: ShapeBlock | None = None
    """Shape, in place of `formation.shape` and `formation.offsets_m`."""
    offsets_m: dict[UavId, Vec3] | None = None
    """Offsets, in place of those of `formation`."""
    slots: Literal["fixed", "optimal"] | None = None
    """Assignment of the slots, in place of `formation.assignment`."""
    trajectory: TrajectoryBlock | None = None
    """Trajectory of the leader, in place of `leader.trajectory`. Its time counts from the begin of the leg."""


class ChangeLeg(Reshaping, LegBlock):
    """The formation changes its shape, while the leader goes on as in the leg before."""

    kind: Literal["change"]


class FollowLeg(LegBlock):
    """The leader joins a trajectory, whose time counts from the begin of the leg."""

    kind: Literal["follow"]
    over_s: Span
    """Duration: by then the leader is on the trajectory. It stays on it until a later leg of the leader."""
    trajectory: TrajectoryBlock
    """The trajectory, one of the kinds of `leader.trajectory`:"""


class GoToLeg(LegBlock):
    """The leader goes to a place, and the formation with it."""

    kind: Literal["go_to"]
    over_s: Span
    """Duration: by then the leader is there, at rest."""
    position_m: Vec3
    """The place."""
    yaw_rad: Number | None = None
    """Heading to turn to. Default: the present one."""


class HoldLeg(LegBlock):
    """The leader comes to rest, and the formation with it."""

    kind: Literal["hold"]
    over_s: Span
    """Duration: by then it is at rest."""


class SplitLeg(LegBlock):
    """A group of followers leaves with a trajectory of its own, while the leader goes on as in the leg before."""

    kind: Literal["split"]
    over_s: Span
    """Duration: by then the group is on its trajectory. It stays on it until it joins."""
    head: UavId
    """The follower that leads the group. The group is this UAV and all below it in `communication.tree`."""
    trajectory: TrajectoryBlock
    """Trajectory of the head, one of the kinds of `leader.trajectory`. Its time counts from the begin of the leg. The
    others of the group keep their places beside the head; heading is that of the leader."""


class JoinLeg(LegBlock):
    """The group that has left comes back to its places beside the leader."""

    kind: Literal["join"]
    over_s: Span
    """Duration: by then every UAV is in its place."""


class LandLeg(LegBlock):
    """Every UAV descends over its place at `gains.hold.land_speed_m_s`. No leg comes after it."""

    kind: Literal["land"]
    over_s: Span
    """Duration: by then every UAV is down."""
    ground_m: Number = 0.0
    """Height of the ground."""


AnyLeg = Annotated[
    TakeOffLeg | FormLeg | ChangeLeg | FollowLeg | GoToLeg | HoldLeg | SplitLeg | JoinLeg | LandLeg,
    Field(discriminator="kind"),
]


class Mission(Block):
    """The task of a formation, leg by leg."""

    start: Utc | None = None
    """Time in UTC of the first epoch, for legs with `at`. In real time the fleet begins then; headless and in lock-step
    the flight counts from it. `12:00:00Z` recurs every day, `*:00:00Z` every hour, `*:*:00Z` every minute."""
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
    match = _WORD.fullmatch(text)
    return None if match is None else int(match[1])


def starts_by_clock(mission: Mission | None) -> bool:
    """True if the mission names the time in UTC at which it begins in real time."""
    return mission is not None and mission.start is not None


def leg_names(mission: Mission) -> list[str]:
    """The name of every leg."""
    return [leg.name or f"{leg.kind}-{number}" for number, leg in enumerate(mission.legs, 1)]


def formed_s(legs: Sequence[ScheduledLeg], number: int) -> float:
    """The time at which leg `number` may take the place of those after the formation has come about."""
    before = [timed for timed in legs if timed.number < number]
    return next((timed for timed in before if isinstance(timed.leg, FormLeg)), before[-1]).end_s


def begin_of(mission: Mission, leg: Any) -> float | None:
    """The latest begin of a leg [s]; None: when the last one is done, or when it is said."""
    if leg.at is not None and mission.start is not None:
        return utc_time(leg.at).after(utc_time(mission.start)) * 1e-9
    return None if leg.at_s is None else float(leg.at_s)


def schedule(
    mission: Mission, deadline_s: float, words: Sequence[Word] = ()
) -> tuple[ScheduledLeg, ...]:
    """The legs that begin, in their order. A word that was said in flight drops what would begin after it."""
    legs = list(_run(mission, deadline_s, 0, 0.0))
    for word in words:
        legs = [leg for leg in legs if leg.begin_s < word.at_s]
        if word.number == CANCEL:
            due_s = word.at_s + mission.cancel_s
            hold = HoldLeg(kind="hold", over_s=max(mission.cancel_s, 0.1))
            legs.append(ScheduledLeg(CANCEL, "cancelled", hold, word.at_s, due_s, due_s))
        else:
            legs.extend(_run(mission, deadline_s, word.number - 1, word.at_s))
    return tuple(legs)


def _run(mission: Mission, deadline_s: float, first: int, begin_s: float) -> Iterator[ScheduledLeg]:
    """The legs from number `first` (from 0) on, until one that waits for a word."""
    end_s, names = begin_s, leg_names(mission)
    for index in range(first, len(mission.legs)):
        leg = mission.legs[index]
        at_s = begin_of(mission, leg) if index > first else begin_s
        if leg.on == "word" and at_s is None:
            return
        begin_s = end_s if at_s is None else max(at_s, end_s)
        over_s = None if index == 0 else leg.over_s
        due_s = begin_s + (deadline_s if over_s is None else over_s)
        end_s = due_s + leg.stay_s
        yield ScheduledLeg(index + 1, names[index], leg, begin_s, due_s, end_s)


def moves_shape(mission: Mission | None) -> bool:
    """True if a leg of the mission moves places beside the leader."""
    legs = mission.legs if mission else ()
    return any(isinstance(leg, TakeOffLeg | ChangeLeg | SplitLeg) for leg in legs)


def takes_off(mission: Mission | None) -> bool:
    """True if the mission begins with a take-off: its first places are those of the starts."""
    return mission is not None and isinstance(mission.legs[0], TakeOffLeg)


def scheduled_changes(
    mission: Mission, legs: Sequence[ScheduledLeg], starts: Places
) -> tuple[Change, ...]:
    """The legs that change the shape, as changes at their times.

    The first one changes nothing. Where a leg may change the shape later, on a word, it is from the first epoch on one
    that moves: it does not matter when a UAV hears of that word. The starts are offsets at the first epoch.
    """
    nothing = Change.model_construct(at_s=0.0, over_s=0.1)
    changes = [nothing] if moves_shape(mission) else []
    for timed in legs:
        keys: dict[str, Any] = {}
        leg, over_s = timed.leg, timed.due_s - timed.begin_s
        if isinstance(leg, TakeOffLeg):
            keys = {"offsets_m": {uav: (x, y, 0.0) for uav, (x, y, _) in starts.items()}}
        elif isinstance(leg, FormLeg) and timed.number > FIRST:
            keys = {"offsets_m": leg.offsets_m}
        elif isinstance(leg, ChangeLeg):
            keys = {key: getattr(leg, key) for key in Reshaping.model_fields}
        if keys:
            keys |= {"at_s": timed.begin_s, "over_s": over_s}
            changes.append(Change.model_construct(**keys))
    return tuple(changes)


def leader_legs(legs: Sequence[ScheduledLeg]) -> tuple[ScheduledLeg, ...]:
    """The legs that move the leader away from its first path. A leg of kind form after the first joins a trajectory."""
    moving = []
    for timed in legs:
        leg = timed.leg
        if isinstance(leg, FormLeg) and timed.number > FIRST and leg.trajectory is not None:
            over_s = timed.due_s - timed.begin_s
            follow = FollowLeg(kind="follow", over_s=over_s, trajectory=leg.trajectory)
            moving.append(timed._replace(leg=follow))
        elif isinstance(leg, TakeOffLeg | FollowLeg | GoToLeg | HoldLeg):
            moving.append(timed)
    return tuple(moving)


_SAME_PATH = (
    (TakeOffLeg, FormLeg, ChangeLeg),
    (TakeOffLeg, FormLeg, FollowLeg, GoToLeg, HoldLeg),
    (SplitLeg, JoinLeg),
)
"""The kinds of legs that move the same places: one of them takes the place of another one."""


def is_cut_short(legs: Sequence[ScheduledLeg], cut: ScheduledLeg) -> bool:
    """True if a later leg took the place of this one before it was due: an operator said so."""
    kinds = tuple(kind for kinds in _SAME_PATH if isinstance(cut.leg, kinds) for kind in kinds)
    stops = isinstance(cut.leg, SplitLeg)  # a group that has left comes to rest with the leader
    return any(
        cut.begin_s < later.begin_s < cut.due_s
        and (isinstance(later.leg, kinds) or (stops and later.number == CANCEL))
        for later in legs
    )
