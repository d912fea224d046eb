"""The path of the leader through the legs of a mission: one table of polynomials.

Between two knots the path has the position, velocity, acceleration and jerk of both, by a polynomial of degree 7
(Hermite interpolation). From rest to rest that is the time profile of the method. A trajectory that the leader follows
has knots on it: between knots 1/16 of a half turn apart, a circle is met to 1e-12 of its radius.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.curves.piecewise import COEFFICIENTS
from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.types import HEADING_TABLE, TRAJECTORY_PIECEWISE, Array, Trajectory
from ptnsbc_sim.scenario.mission.legs import (
    CANCEL,
    FollowLeg,
    GoToLeg,
    JoinLeg,
    ScheduledLeg,
    SplitLeg,
    TakeOffLeg,
    Word,
    leader_legs,
    schedule,
    scheduled_changes,
)
from ptnsbc_sim.scenario.mission.shapes import Apart, hermite, place_rows, summed
from ptnsbc_sim.scenario.mission.trajectories import (
    NO_TABLE,
    Circle,
    Csv,
    Lissajous,
    Route,
    Waypoints,
    trajectory_of,
)

MOST_KNOTS = 20_000
"""Of one route."""

_TURN = math.pi / 16  # of a periodic path between two knots
_HEADING_STEP_S = 0.1  # between two knots of a path that the leader looks along
_APART_S = 1e-6  # knots are at least so far apart
_YAW = 12  # column of `curve_samples`
_MARGIN_S = 60.0  # of a route beyond the flight


def with_legs(file: Any, words: Sequence[Word] = ()) -> Any:
    """A scenario file without `problems`, whose trajectory and changes of the shape are those of its mission.

    Raises:
        ValueError: the path of the leader takes too many polynomials, in words that follow the name of the file.
    """
    if file.mission is None:
        return file
    legs = schedule(file.mission, file.gains.formation.deadline_s, words)
    path = file.leader.trajectory
    first = path.first if isinstance(path, Route) else path
    route = route_of(first, leader_legs(legs), file.timing.duration_s + _MARGIN_S)
    if route is None:
        raise ValueError(_too_many("leader"))
    changes = scheduled_changes(file.mission, legs, file.formation.offsets_m)
    formation = file.formation.model_copy(update={"changes": changes})
    file = file.model_copy(update={"formation": formation})
    route = replace(route, apart=tuple(_apart(file, route, legs)))
    return file.model_copy(update={"leader": file.leader.model_copy(update={"trajectory": route})})


def _too_many(whose: str) -> str:
    return (
        f"mission.legs: the path of the {whose} takes more than {MOST_KNOTS} polynomials: expected a shorter "
        "timing.duration_s, or fewer points"
    )


def _spans(legs: Sequence[ScheduledLeg]) -> list[list[ScheduledLeg]]:
    """The legs that move each group: the one with which it leaves, those with which it rests, the one of its return.

    Raises:
        ValueError: a leg that does not fit where it begins.
    """
    spans: list[list[ScheduledLeg]] = []
    for one in legs:
        apart = bool(spans) and not isinstance(spans[-1][-1].leg, JoinLeg)
        if isinstance(one.leg, SplitLeg):
            if apart:
                raise ValueError(f"mission.legs: {one.name}: expected a leg of kind join before it")
            spans.append([one])
        elif isinstance(one.leg, JoinLeg):
            if not apart:
                raise ValueError(
                    f"mission.legs: {one.name}: expected a leg of kind split before it"
                )
            spans[-1].append(one)
        elif one.number == CANCEL and apart:
            spans[-1].append(one)
    return spans


def _apart(file: Any, route: Route, legs: Sequence[ScheduledLeg]) -> Iterator[Apart]:
    """The groups that leave, and by what their places are displaced meanwhile: the path of the head less its place.

    A group comes back by a displacement that ends at rest, so it does not matter what the leader does meanwhile.
    """
    for span in _spans(legs):
        first, last = span[0], span[-1]
        back = last if isinstance(last.leg, JoinLeg) else None
        place = summed(route.curve.table, place_rows(file, first.leg.head))
        path = _through(place, span[:-1] if back else span, route.until_s)
        if path is None:
            raise ValueError(_too_many("group"))
        beside = summed(path, place, -1.0)
        beside = beside[beside[:, 0] > first.begin_s - _APART_S]
        if back is not None:
            beside = beside[beside[:, 0] < back.begin_s - _APART_S]
            now = curve_samples(_curve(beside), np.array([back.begin_s]))[0]
            knots = [_Knot(back.begin_s, now, 4), _Knot(back.due_s, np.zeros(15), 4)]
            beside = np.concatenate([beside, _rows(knots)])
        rows = np.concatenate([np.zeros((1, beside.shape[1])), beside])
        yield Apart(first.leg.head, first.begin_s, rows[:, : 1 + 3 * COEFFICIENTS])


class _Knot(NamedTuple):
    """A point of the path."""

    t: float  # [s]
    state: Array  # (15,) a row of `curve_samples`
    known: int  # derivatives of the position that are the same before and after it, the position included


def route_of(first: Any, legs: tuple[ScheduledLeg, ...], until_s: float) -> Route | None:
    """The route that begins with the trajectory block `first`; None when it takes too many polynomials.

    What is flown before a leg begins does not depend on that leg, to the last bit: a UAV may hear of it late.
    """
    knots = _follow(first, 0.0, 0.0, until_s)
    rows = None if knots is None else _through(_rows(knots), legs, until_s)
    return None if rows is None else Route(first, legs, until_s, _curve(rows))


def _through(rows: Array, legs: Sequence[ScheduledLeg], until_s: float) -> Array | None:
    """A path that goes on by these legs; None when it takes too many polynomials."""
    for leg in legs:
        before = rows[rows[:, 0] < leg.begin_s - _APART_S]
        flown = before if len(before) else rows  # a leg may begin with the path
        now = curve_samples(_curve(flown), np.array([leg.begin_s]))[0]
        rows = before
        knots = _flown(leg, now, until_s)
        if knots is None or len(rows) + len(knots) > MOST_KNOTS:
            return None
        rows = np.concatenate([rows, _rows([_Knot(leg.begin_s, now, 4), *knots])])
    return rows


def _flown(one: ScheduledLeg, now: Array, until_s: float) -> list[_Knot] | None:
    """The knots of a leg that begins in a state (15,)."""
    leg = one.leg
    if isinstance(leg, FollowLeg | SplitLeg):
        joined = _follow(leg.trajectory, one.begin_s, leg.over_s, until_s)
        if joined is not None:
            turn = _nearest_turn(joined[0].state[_YAW], now[_YAW])
            for knot in joined:
                knot.state[_YAW] += turn
        return joined
    rest = np.zeros(15)
    rest[0:3] = now[0:3] + 0.5 * (one.due_s - one.begin_s) * now[3:6]
    rest[_YAW] = now[_YAW]
    if isinstance(leg, TakeOffLeg):
        rest[2] = leg.height_m
    if isinstance(leg, GoToLeg):
        rest[0:3] = leg.position_m
        if leg.yaw_rad is not None:
            rest[_YAW] = leg.yaw_rad + _nearest_turn(leg.yaw_rad, now[_YAW])
    return [_Knot(one.due_s, rest, 4)]


def _nearest_turn(angle: float, to: float) -> float:
    """The turn to add to an angle so that it lies within half a turn of another one."""
    return float(to + wrap_angle(angle - to) - angle)


def _follow(block: Any, begin_s: float, from_s: float, until_s: float) -> list[_Knot] | None:
    """Knots on a trajectory, from `from_s` of its own time, which counts from `begin_s`, until `until_s`."""
    curve = trajectory_of(block)
    known = 2 if getattr(block, "through", "") == "cubic" or isinstance(block, Csv) else 4
    times = _knot_times(block, curve, from_s, until_s - begin_s)
    if times is None:
        return None
    at = curve_samples(curve, times)
    at[:, _YAW] = np.unwrap(at[:, _YAW])
    found = [_Knot(begin_s + float(t), row, known) for t, row in zip(times, at, strict=True)]
    return [found[0]._replace(known=4), *found[1:]]


def _knot_times(block: Any, curve: Trajectory, first: float, last: float) -> Array | None:
    """Ascending times [s] of knots on a curve; None when there are too many."""
    last = max(last, first + _APART_S)
    found = [np.array([first, last])]
    if isinstance(block, Circle | Lissajous):
        rates = (block.rate_rad_s,) if isinstance(block, Circle) else block.rate_rad_s
        found.append(_even(first, last, _TURN / max(*map(abs, rates), 1e-9)))
    if curve.numbers[0] == TRAJECTORY_PIECEWISE:
        ends, period = curve.table[:, 0], float(curve.numbers[2])
        laps = np.arange(max(last // period + 1, 1)) * period if period > 0.0 else np.zeros(1)
        if len(laps) * len(ends) > MOST_KNOTS:
            return None
        found.append((laps[:, None] + ends[None]).ravel())
        if isinstance(block, Waypoints | Csv) and block.heading == "path":
            found.append(_even(first, last, _HEADING_STEP_S))
    times = np.concatenate(found)
    times = np.unique(times[(times >= first) & (times <= last)])
    times = times[np.diff(times, prepend=-math.inf) > _APART_S]
    return times if len(times) <= MOST_KNOTS else None


def _even(first: float, last: float, step: float) -> Array:
    """Times of a knot every `step`, at most one more than a route may have."""
    count = min(max(math.ceil((last - first) / step), 1), MOST_KNOTS + 1)
    return np.linspace(first, last, count + 1)


def _rows(knots: Sequence[_Knot]) -> Array:
    """Polynomials (K, 33) through knots; the last row stays at the last of them."""
    times = np.array([knot.t for knot in knots])
    rows = np.zeros((len(knots), NO_TABLE.shape[1]))
    rows[:, 0] = times
    for channel in range(4):
        columns = [_YAW, _YAW + 1, _YAW + 2] if channel == 3 else [*range(channel, 12, 3)]
        values = [knot.state[columns[: knot.known]] for knot in knots]
        at = 1 + COEFFICIENTS * channel
        if len(knots) > 1:
            rows[:-1, at : at + COEFFICIENTS] = hermite(times, values)
        rows[-1, at + COEFFICIENTS - 1] = values[-1][0]
    return rows


def _curve(rows: Array) -> Trajectory:
    numbers = (TRAJECTORY_PIECEWISE, HEADING_TABLE, 0, 0, 0, 0, 0, 0)
    return Trajectory(tuple(float(number) for number in numbers), np.ascontiguousarray(rows))
