"""A leader that follows setpoints from outside: what it does with each of them, and without any.

From each setpoint on the leader flies one polynomial of degree 7, which begins in the state where the one before has
come to and ends on the setpoint as it moves on. It takes `join_s`, or as much longer as the limits need. Then the
leader moves on with the setpoint, and without a further one for `silent_s` it comes to rest. The whole of it is known
when the setpoint arrives, and is within the limits and the region, or the setpoint is refused: see docs/missions.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.curves.trajectory import COEFFICIENTS, curve_samples
from ptnsbc_core.kinematics import yaw_of
from ptnsbc_core.types import Array, Trajectory
from ptnsbc_io.number_table import read_table
from ptnsbc_sim.scenario.fields import MOST_SAMPLES, Block, Number, Positive, Vec3
from ptnsbc_sim.scenario.mission.pieces import CHANNELS, WIDTH, YAW, conditions, curve_of
from ptnsbc_sim.scenario.problems import Problem, Problems, unless

_STRETCH: Array = np.power(1.25, np.arange(20.0))  # of join_s and stop_s, up to 69 times
_SHARES = np.linspace(0.0, 1.0, 65)  # of a polynomial, at which it is compared with the limits
_SLACK = 1.0 + 1e-6
_INVERSE = np.asarray(np.linalg.inv(conditions(4, 4)), dtype=np.float64)
_LIVE_ROWS = 8  # that a process keeps which flies


class SetpointTrajectory(Block):
    """Setpoints from outside."""

    kind: Literal["stream"]
    """Setpoints from outside, on the topic `/formation/setpoint` (nav_msgs/Odometry) or from a file, see
    [missions.md](missions.md#a-stream-of-setpoints)."""
    position_m: Vec3
    """Position until the first setpoint."""
    yaw_rad: Number = 0.0
    """Heading until the first setpoint."""
    low_m: Vec3
    """Lowest corner of the region that the leader stays in."""
    high_m: Vec3
    """Highest corner of it."""
    speed_m_s: Positive
    """Largest speed."""
    acceleration_m_s2: Positive
    """Largest acceleration."""
    jerk_m_s3: Positive = 20.0
    """Largest jerk."""
    turn_rad_s: Positive = 1.0
    """Largest rate of the heading."""
    join_s: Annotated[Number, Field(ge=0.05, le=10.0)] = 0.5
    """Time from a setpoint until the leader is on it, where the limits allow that."""
    silent_s: Annotated[Number, Field(ge=0.05, le=60.0)] = 0.5
    """Time without a setpoint after which the leader comes to rest."""
    stop_s: Annotated[Number, Field(ge=0.05, le=60.0)] = 2.0
    """Time in which it comes to rest, where the limits allow that."""
    file: str | None = None
    """CSV file that plays the stream, looked for beside the scenario. It becomes `samples` when it is read."""
    samples: Annotated[str, Field(max_length=MOST_SAMPLES)] | None = None
    """The content of such a file: rows t [s], x, y, z [m], vx, vy, vz [m/s], yaw [rad], or names and
    units of the columns in the first row. No topic is heard then."""


class Setpoint(NamedTuple):
    """The wanted place of the leader, and its motion; world ENU."""

    at_s: float  # from when it counts [s since the first epoch]
    position: tuple[float, float, float]  # [m]
    velocity: tuple[float, float, float]  # [m/s]
    yaw: float  # [rad]


def setpoint_of(at_s: float, odometry: Array) -> Setpoint:
    """The setpoint in an odometry vector (13,) whose velocities are in the world."""
    x, y, z, _, _, _, _, vx, vy, vz = odometry[:10].tolist()
    return Setpoint(at_s, (x, y, z), (vx, vy, vz), yaw_of(odometry))


class SetpointError(ValueError):
    """A setpoint that the leader cannot follow within its limits."""


@dataclass(frozen=True)
class Streamed:
    """The path of the leader along the setpoints so far, in the place of the trajectory block."""

    block: SetpointTrajectory
    setpoints: tuple[Setpoint, ...]
    curve: Trajectory = field(compare=False)


def takes_setpoints(path: Any) -> bool:
    """True if a leader with this trajectory takes setpoints from a topic."""
    block = path.block if isinstance(path, Streamed) else path
    return isinstance(block, SetpointTrajectory) and block.samples is None


def stream_problems(block: SetpointTrajectory) -> Problems:
    """The errors of a stream."""
    low, high, place = (np.array(at) for at in (block.low_m, block.high_m, block.position_m))
    above = f"above low_m {list(block.low_m)} on each axis"
    yield from unless((low < high).all(), "high_m", list(block.high_m), above)
    inside = ((low <= place) & (place <= high)).all()
    yield from unless(inside, "position_m", list(block.position_m), "from low_m to high_m")
    try:
        streamed(block, setpoints_of(block.samples or ""))
    except ValueError as error:
        yield Problem("samples", str(error), "")


def setpoints_of(text: str) -> tuple[Setpoint, ...]:
    """The rows of a CSV text.

    Raises:
        ValueError: a row that is no setpoint, in words that follow a key.
    """
    rows = read_table(text, ("t", "x", "y", "z", "vx", "vy", "vz", "yaw"))
    if late := np.flatnonzero(np.diff(rows[:, 0]) <= 0.0).tolist():
        row = late[0] + 1
        raise ValueError(
            f"row {row + 1} of numbers: t = {rows[row, 0]:g}: expected times that ascend"
        )
    return tuple(
        Setpoint(t, (x, y, z), (vx, vy, vz), yaw) for t, x, y, z, vx, vy, vz, yaw in rows.tolist()
    )


def streamed(block: SetpointTrajectory, setpoints: Sequence[Setpoint]) -> Streamed:
    """The path of the leader along setpoints.

    What is flown before a setpoint counts does not depend on it, to the last bit.

    Raises:
        SetpointError: one is before the one before, or cannot be followed within the limits.
    """
    done, rows, before_s = [], _resting(block), -1.0
    for setpoint in setpoints:
        try:
            before_s = _later(setpoint, before_s)
            kept, added = _extended(block, rows, setpoint)
        except SetpointError as error:
            raise SetpointError(f"setpoint at {setpoint.at_s:g} s: {error}") from None
        done.append(kept[:-1])
        rows = np.concatenate([kept[-1:], added])
    return Streamed(block, tuple(setpoints), curve_of(np.concatenate([*done, rows])))


def going_on(path: Streamed, setpoint: Setpoint) -> Streamed:
    """The path after one more setpoint, for a process that flies: what is long past is forgotten.

    Raises:
        SetpointError: the leader cannot follow it, and the path before goes on.
    """
    _later(setpoint, path.setpoints[-1].at_s if path.setpoints else -1.0)
    kept, added = _extended(path.block, path.curve.table, setpoint)
    rows = np.concatenate([kept[-_LIVE_ROWS:], added])
    return Streamed(path.block, (setpoint,), curve_of(rows))


def _later(setpoint: Setpoint, before_s: float) -> float:
    """The time from which a setpoint counts [s]: not before the previous one, which one of the same time replaces."""
    if not (setpoint.at_s >= 0.0 and setpoint.at_s >= before_s):
        raise SetpointError(f"expected a time from the first epoch on, and from {before_s:g} s on")
    return setpoint.at_s


def _resting(block: SetpointTrajectory) -> Array:
    """The rows of a leader without setpoints."""
    row = np.zeros((1, WIDTH))
    row[0, COEFFICIENTS::COEFFICIENTS] = (*block.position_m, block.yaw_rad)
    return row


def _extended(block: SetpointTrajectory, rows: Array, setpoint: Setpoint) -> tuple[Array, Array]:
    """The rows that begin before a setpoint, and those from it on."""
    kept = rows[rows[:, 0] < setpoint.at_s] if setpoint.at_s > 0.0 else _resting(block)
    place = np.array(setpoint.position)
    if not ((block.low_m <= place) & (place <= block.high_m)).all():
        raise SetpointError(
            f"position {list(setpoint.position)}: expected one from low_m to high_m"
        )
    speed = math.hypot(*setpoint.velocity)
    if not speed <= block.speed_m_s:
        raise SetpointError(f"{speed:.3g} m/s: expected at most speed_m_s, {block.speed_m_s:g} m/s")
    now = _state(kept, setpoint.at_s)
    goal = np.zeros((4, CHANNELS))
    goal[0] = (*setpoint.position, setpoint.yaw)
    goal[0, 3] = now[0, 3] + wrap_angle(setpoint.yaw - now[0, 3])
    goal[1, :3] = setpoint.velocity
    return kept, _planned(block, now, goal, setpoint.at_s)


def _planned(block: SetpointTrajectory, now: Array, goal: Array, at_s: float) -> Array:
    """Rows from a state (4, 4) onto a goal that moves on, and to rest when nothing more comes.

    Raises:
        SetpointError: none are within the limits.
    """
    reason = ""
    for goals, spans in _goals(block, goal):
        joins = _polynomials(now, goals, spans)
        for index, span in enumerate(spans.tolist()):
            reason = _beyond(block, now, joins[index], span, block.silent_s)
            if reason:
                continue
            rows = [_row(at_s, joins[index])]
            silent_s = at_s + block.silent_s
            if span < block.silent_s:
                rows.append(_moving(at_s + span, goals[index]))
            last = _state(np.array(rows), silent_s)
            rest, reason = _braked(block, last)
            if rest is not None:
                lasting, stop = rest
                end = np.zeros((4, CHANNELS))
                end[0] = _values(stop[None], lasting)[0, 0, -1]
                return np.array([*rows, _row(silent_s, stop), _moving(silent_s + lasting, end)])
    raise SetpointError(f"{reason}: expected one that it can follow within its limits")


def _goals(block: SetpointTrajectory, goal: Array) -> Iterator[tuple[Array, Array]]:
    """States (K, 4, 4) to join a goal (4, 4) in, and the spans [s] until then.

    First where the goal will be, with its velocity. Where that is too far, at rest where it will be when it counts as
    silent.
    """
    spans = block.join_s * _STRETCH
    goals = np.repeat(goal[None], len(spans), axis=0)
    goals[:, 0] += spans[:, None] * goal[1]
    yield goals, spans
    goals[:, 0], goals[:, 1] = goal[0] + block.silent_s * goal[1], 0.0
    yield goals, spans


def _braked(block: SetpointTrajectory, last: Array) -> tuple[tuple[float, Array] | None, str]:
    """The time and the polynomial by which a leader in a state (4, 4) comes to rest; why there is none."""
    spans, reason = block.stop_s * _STRETCH, ""
    rests = np.zeros((len(spans), 4, CHANNELS))
    rests[:, 0] = last[0] + 0.5 * spans[:, None] * last[1]
    stops = _polynomials(last, rests, spans)
    for index, span in enumerate(spans.tolist()):
        reason = _beyond(block, last, stops[index], span)
        if not reason:
            return (span, stops[index]), ""
    return None, f"coming to rest after it, {reason}"


def _polynomials(first: Array, lasts: Array, spans: Array) -> Array:
    """Coefficients (K, 4, 8), the highest power first, from a state (4, 4) to K others within K spans [s]."""
    powers = spans[:, None] ** np.arange(4)
    ends = np.concatenate([first * powers[:, :, None], lasts * powers[:, :, None]], axis=1)
    of_share = np.einsum("ij,kjc->kci", _INVERSE, ends)
    coefficients: Array = (of_share / (spans[:, None, None] ** np.arange(COEFFICIENTS)))[:, :, ::-1]
    return coefficients


@cache
def _powers() -> Array:
    """Derivatives 0 to 3 of the powers of the share (4, 65, 8), the highest power first."""
    units = [np.poly1d([1.0, *[0.0] * power]) for power in reversed(range(COEFFICIENTS))]
    return np.array(
        [[(one.deriv(k) if k else one)(_SHARES) for one in units] for k in range(4)]
    ).transpose(0, 2, 1)


def _values(polynomials: Array, span: float) -> Array:
    """Polynomials (..., 4, 8) and three derivatives at `_SHARES` of a span [s]: (..., 4, 65, 4)."""
    shares = polynomials * span ** np.arange(COEFFICIENTS)[::-1]
    scales = span ** -np.arange(4.0)
    values: Array = np.einsum("dsp,...cp,d->...dsc", _powers(), shares, scales)
    return values


def _beyond(
    block: SetpointTrajectory, now: Array, polynomial: Array, span: float, until_s: float = math.inf
) -> str:
    """The limit beyond which a polynomial (4, 8) goes, empty for none; it is in the region until `until_s`."""
    at = _values(polynomial, span)
    places = at[0, _SHARES * span <= until_s, :3]
    if not ((block.low_m <= places + 1e-6) & (places - 1e-6 <= block.high_m)).all():
        return "it leaves the region from low_m to high_m"
    limits = (block.speed_m_s, block.acceleration_m_s2, block.jerk_m_s3)
    for derivative, (limit, unit) in enumerate(zip(limits, ("m/s", "m/s^2", "m/s^3"), strict=True)):
        most = float(np.linalg.norm(at[derivative + 1, :, :3], axis=1).max())
        already = float(np.linalg.norm(now[derivative + 1, :3]))
        if not most <= max(limit, already) * _SLACK:
            return f"it takes {most:.3g} {unit} of {limit:g} {unit}"
    turn = float(np.abs(at[1, :, 3]).max())
    if not turn <= max(block.turn_rad_s, abs(float(now[1, 3]))) * _SLACK:
        return f"it turns by {turn:.3g} rad/s of {block.turn_rad_s:g} rad/s"
    return ""


def _row(begin_s: float, polynomial: Array) -> Array:
    return np.concatenate([[begin_s], polynomial.ravel()])


def _moving(begin_s: float, state: Array) -> Array:
    """A row that moves on from a state (4, 4) with its velocity."""
    channels = np.zeros((CHANNELS, COEFFICIENTS))
    channels[:, -1], channels[:, -2] = state[0], state[1]
    return _row(begin_s, channels)


def _state(rows: Array, t: float) -> Array:
    """Value and three derivatives of x, y, z and yaw (4, 4) at a time; the yaw has two."""
    at = curve_samples(curve_of(rows), np.array([t]))[0]
    state = np.zeros((4, CHANNELS))
    state[:, :3] = at[:12].reshape(4, 3)
    state[:3, 3] = at[YAW : YAW + 3]
    return state
