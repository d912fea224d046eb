"""The moving parts of a flight, as tables of polynomials: the leader's path through the legs, and places beside it.

Between two knots the path has the position, velocity, acceleration and jerk of both, by a polynomial of degree 7
(Hermite interpolation). From rest to rest that is the time profile of the method. A trajectory that the leader follows
has knots on it: between knots 1/16 of a half turn apart, a circle is met to 1e-12 of its radius.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.curves.shape import CHANNELS, place_samples
from ptnsbc_core.curves.trajectory import COEFFICIENTS, curve_samples
from ptnsbc_core.types import TRAJECTORY_PIECEWISE, Array, Shape, Trajectory
from ptnsbc_sim.scenario.fields import replaced
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
from ptnsbc_sim.scenario.mission.pieces import WIDTH, YAW, at_knots, curve_of, hermite, summed
from ptnsbc_sim.scenario.mission.shapes import Change, changed
from ptnsbc_sim.scenario.mission.trajectories import (
    AnyPath,
    Apart,
    Circle,
    Lissajous,
    PathFile,
    Route,
    Waypoints,
    trajectory_of,
)
from ptnsbc_sim.scenario.model import Formation, ScenarioFile
from ptnsbc_sim.scenario.problems import ScenarioError

MOST_KNOTS = 20_000
"""Of one route."""

_TURN = math.pi / 16  # of a periodic path between two knots
_HEADING_STEP_S = 0.1  # between two knots of a path that the leader looks along
_APART_S = 1e-6  # knots are at least so far apart
_MARGIN_S = 60.0  # of a route beyond the flight
_RISE = (-20.0, 70.0, -84.0, 35.0)  # h of the time base, the powers 7 to 4
_STANDING = Shape(False, False, np.zeros((0, 1 + COEFFICIENTS * CHANNELS)))

_File = TypeVar("_File", bound=ScenarioFile)


def with_route(file: _File, source: str, words: Sequence[Word] = ()) -> _File:
    """A checked file with the trajectory and the changes of the shape of its mission.

    Raises:
        ScenarioError: the path of the leader takes too many polynomials, or a leg does not fit where it begins.
    """
    if file.mission is None:
        return file
    legs = schedule(file.mission, file.gains.formation.deadline_s, words)
    path = file.leader.trajectory
    first = path.first if isinstance(path, Route) else path
    until_s = file.timing.duration_s + _MARGIN_S
    try:
        moving, start = leader_legs(legs), _rows(_follow(first, 0.0, 0.0, until_s))
        route = Route(first, moving, until_s, curve_of(_through(start, moving, until_s)))
        changes = scheduled_changes(file.mission, legs, file.formation.offsets_m)
        file = replaced(file, {"formation.changes": changes})
        route = replace(route, apart=tuple(_apart(file, route, legs)))
    except ValueError as error:
        raise ScenarioError(f"{source}: mission.legs: {error}") from None
    return replaced(file, {"leader.trajectory": route})


def _spans(legs: Sequence[ScheduledLeg]) -> list[list[ScheduledLeg]]:
    """The legs that move each group: the one with which it leaves, those with which it rests, the one of its return.

    Raises:
        ValueError: a leg that does not fit where it begins.
    """
    spans: list[list[ScheduledLeg]] = []
    for timed in legs:
        apart = bool(spans) and not isinstance(spans[-1][-1].leg, JoinLeg)
        if isinstance(timed.leg, SplitLeg):
            if apart:
                raise ValueError(f"{timed.name}: expected a leg of kind join before it")
            spans.append([timed])
        elif isinstance(timed.leg, JoinLeg):
            if not apart:
                raise ValueError(f"{timed.name}: expected a leg of kind split before it")
            spans[-1].append(timed)
        elif timed.number == CANCEL and apart:
            spans[-1].append(timed)
    return spans


def _apart(file: ScenarioFile, route: Route, legs: Sequence[ScheduledLeg]) -> Iterator[Apart]:
    """The groups that leave, and by what their places are displaced meanwhile: the path of the head less its place.

    A group comes back by a displacement that ends at rest, so it does not matter what the leader does meanwhile.
    """
    for span in _spans(legs):
        first, last = span[0], span[-1]
        back = last if isinstance(last.leg, JoinLeg) else None
        stages = _stages(file.formation, first.leg.head)
        place = summed(route.curve.table, _table(file.formation.changes, stages))
        path = _through(place, span[:-1] if back else span, route.until_s)
        beside = summed(path, place, -1.0)
        beside = beside[beside[:, 0] > first.begin_s - _APART_S]
        if back is not None:
            beside = beside[beside[:, 0] < back.begin_s - _APART_S]
            now = curve_samples(curve_of(beside), np.array([back.begin_s]))[0]
            knots = [_Knot(back.begin_s, now, 4), _Knot(back.due_s, np.zeros(15), 4)]
            beside = np.concatenate([beside, _rows(knots)])
        rows = np.concatenate([np.zeros((1, beside.shape[1])), beside])
        yield Apart(first.leg.head, first.begin_s, rows[:, : 1 + 3 * COEFFICIENTS])


class _Knot(NamedTuple):
    """A point of the path."""

    t: float  # [s]
    state: Array  # (15,) a row of `curve_samples`
    known: int  # derivatives of the position that are the same before and after it, the position included


def _through(rows: Array, legs: Sequence[ScheduledLeg], until_s: float) -> Array:
    """A path that goes on by these legs.

    What is flown before a leg begins does not depend on that leg, to the last bit: a UAV may hear of it late.
    """
    for leg in legs:
        before = rows[rows[:, 0] < leg.begin_s - _APART_S]
        flown = before if len(before) else rows  # a leg may begin with the path
        now = curve_samples(curve_of(flown), np.array([leg.begin_s]))[0]
        knots = _flown(leg, now, until_s)
        _refuse_many(len(before) + len(knots))
        rows = np.concatenate([before, _rows([_Knot(leg.begin_s, now, 4), *knots])])
    return rows


def _refuse_many(knots: float) -> None:
    if knots > MOST_KNOTS:
        raise ValueError(
            f"the path of the leader or of a group takes more than {MOST_KNOTS} polynomials: expected a shorter "
            "timing.duration_s, or fewer points"
        )


def _flown(timed: ScheduledLeg, now: Array, until_s: float) -> list[_Knot]:
    """The knots of a leg that begins in a state (15,)."""
    leg = timed.leg
    if isinstance(leg, FollowLeg | SplitLeg):
        joined = _follow(leg.trajectory, timed.begin_s, leg.over_s, until_s)
        turn = _nearest_turn(joined[0].state[YAW], now[YAW])
        for knot in joined:
            knot.state[YAW] += turn
        return joined
    rest = np.zeros(15)
    rest[0:3] = now[0:3] + 0.5 * (timed.due_s - timed.begin_s) * now[3:6]
    rest[YAW] = now[YAW]
    if isinstance(leg, TakeOffLeg):
        rest[2] = leg.height_m
    if isinstance(leg, GoToLeg):
        rest[0:3] = leg.position_m
        if leg.yaw_rad is not None:
            rest[YAW] = leg.yaw_rad + _nearest_turn(leg.yaw_rad, now[YAW])
    return [_Knot(timed.due_s, rest, 4)]


def _nearest_turn(angle: float, to: float) -> float:
    """The turn to add to an angle so that it lies within half a turn of another one."""
    return float(to + wrap_angle(angle - to) - angle)


def _follow(block: AnyPath, begin_s: float, from_s: float, until_s: float) -> list[_Knot]:
    """Knots on a trajectory, from `from_s` of its own time, which counts from `begin_s`, until `until_s`."""
    curve, rough = trajectory_of(block), isinstance(block, PathFile)
    rough = rough or (isinstance(block, Waypoints) and block.through == "cubic")
    times = _knot_times(block, curve, from_s, until_s - begin_s)
    at = curve_samples(curve, times)
    at[:, YAW] = np.unwrap(at[:, YAW])
    return [
        _Knot(begin_s + float(t), row, 2 if rough and k else 4)
        for k, (t, row) in enumerate(zip(times, at, strict=True))
    ]


def _knot_times(block: AnyPath, curve: Trajectory, first: float, last: float) -> Array:
    """Ascending times [s] of knots on a curve."""
    last = max(last, first + _APART_S)
    parts = [np.array([first, last])]
    if isinstance(block, Circle | Lissajous):
        rates = (block.rate_rad_s,) if isinstance(block, Circle) else block.rate_rad_s
        parts.append(_even(first, last, _TURN / max(*map(abs, rates), 1e-9)))
    if curve.numbers[0] == TRAJECTORY_PIECEWISE:
        ends, period = curve.table[:, 0], float(curve.numbers[2])
        laps = max(last // period + 1, 1) if period > 0.0 else 1
        _refuse_many(laps * len(ends))
        parts.append((np.arange(laps)[:, None] * period + ends[None]).ravel())
        if isinstance(block, Waypoints | PathFile) and block.heading == "path":
            parts.append(_even(first, last, _HEADING_STEP_S))
    times = np.concatenate(parts)
    times = np.unique(times[(times >= first) & (times <= last)])
    times = times[np.diff(times, prepend=-math.inf) > _APART_S]
    _refuse_many(len(times))
    return times


def _even(first: float, last: float, step: float) -> Array:
    """Times of a knot every `step`, at most one more than a route may have."""
    count = min(max(math.ceil((last - first) / step), 1), MOST_KNOTS + 1)
    return np.linspace(first, last, count + 1)


def _rows(knots: Sequence[_Knot]) -> Array:
    """Polynomials (K, 33) through knots; the last row stays at the last of them."""
    times = np.array([knot.t for knot in knots])
    rows = np.zeros((len(knots), WIDTH))
    rows[:, 0] = times
    for channel in range(4):
        columns = [YAW, YAW + 1, YAW + 2] if channel == 3 else [*range(channel, 12, 3)]
        values = [knot.state[columns[: knot.known]] for knot in knots]
        at = 1 + COEFFICIENTS * channel
        if len(knots) > 1:
            rows[:-1, at : at + COEFFICIENTS] = hermite(times, values)
        rows[-1, at + COEFFICIENTS - 1] = values[-1][0]
    return rows


def shape_of(file: ScenarioFile, uav: int) -> Shape:
    """The motion of the places of a UAV and its parent, in a whole scenario file."""
    formation, tree = file.formation, file.communication.tree
    if not formation.moves:
        return _STANDING
    parent = tree.get(uav)
    own, above = _stages(formation, uav), _stages(formation, parent)
    turns = [0.0, *(change.rotation_rad for change in formation.changes)]
    stages = np.concatenate([own, above, np.array(turns)[:, None]], axis=1)
    table = _table(formation.changes, stages)
    path = file.leader.trajectory
    for group in path.apart if isinstance(path, Route) else ():
        for at, member in enumerate((uav, parent)):
            if _is_below(tree, member, group.head):
                times = np.union1d(table[:, 0], group.rows[:, 0])
                table, rows = at_knots(table, times), at_knots(group.rows, times)
                width = rows.shape[1] - 1
                table[:, 1 + width * at : 1 + width * (at + 1)] += rows[:, 1:]
    return Shape(True, formation.frame == "heading", table)


def places_beside_leader(file: ScenarioFile, uav: int, times: Array) -> Array:
    """Desired positions (T, 3) [m], ENU, relative to the leader, at times (T,) [s] since the first epoch."""
    if uav == file.leader.id or not file.formation.moves:
        return np.repeat(file.offset(uav)[None], len(times), axis=0)
    return place_samples(shape_of(file, uav), trajectory_of(file.leader.trajectory), times)[:, :3]


def _is_below(tree: Mapping[int, int], uav: int | None, head: int) -> bool:
    """True for the head of a group and all UAVs below it in the tree."""
    while uav is not None and uav != head:
        uav = tree.get(uav)
    return uav == head


def _stages(formation: Formation, uav: int | None) -> Array:
    """Places (1 + C, 3) of a UAV in the axes of the shape: at first and after each change; zeros for the leader."""
    place = np.array(formation.offsets_m.get(uav or 0, (0.0, 0.0, 0.0)), dtype=np.float64)
    stages = [place]
    for change in formation.changes:
        if change.offsets_m is not None:
            place = np.array(change.offsets_m.get(uav or 0, (0.0, 0.0, 0.0)), dtype=np.float64)
        stages.append(changed(change, place))
    return np.stack(stages)


def _table(changes: tuple[Change, ...], stages: Array) -> Array:
    """Polynomials from stage to stage (1 + C, K): at rest, then by h of the time base, then at rest again.

    A change that begins before the last one is done goes on from where that is, by a polynomial with the same
    derivatives there.
    """
    rows = [_row(0.0, stages[0], np.zeros_like(stages[0]), 1.0)]
    for change, (before, after) in zip(changes, pairwise(stages), strict=True):
        if change.at_s < rows[-1][0]:
            rows[-1] = _moving_row(rows[-2], change, after)
        else:
            rows.append(_row(change.at_s, before, after - before, change.over_s))
        rows.append(_row(change.at_s + change.over_s, after, np.zeros_like(after), 1.0))
    return np.array(rows)


def _moving_row(last: Array, change: Change, after: Array) -> Array:
    """The row of a change that begins in the middle of row `last`."""
    row = np.zeros_like(last)
    row[0] = change.at_s
    times = np.array([change.at_s, change.at_s + change.over_s])
    for channel in range(len(after)):
        at = slice(1 + COEFFICIENTS * channel, 1 + COEFFICIENTS * (channel + 1))
        whole = np.poly1d(last[at])
        now = [whole.deriv(k)(change.at_s - last[0]) for k in range(4)]
        row[at] = hermite(times, [np.array(now), np.array([after[channel], 0.0, 0.0, 0.0])])[0]
    return row


def _row(begin: float, first: Array, step: Array, over: float) -> Array:
    channels = np.zeros((len(step), COEFFICIENTS))
    spans = np.array([over ** (7 - k) for k in range(len(_RISE))])
    channels[:, : len(_RISE)] = np.array(_RISE) * step[:, None] / spans
    channels[:, -1] = first
    return np.concatenate([[begin], channels.ravel()])
