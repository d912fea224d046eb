"""The leader's desired trajectory: numbers from which every process computes the same curve.

Layout of the eight numbers and of the table:

- circle [0, cx, cy, cz, radius, rate, phase, yaw] with x = cx + r sin(rate t + phase),
  y = cy + r cos(rate t + phase), as the paper writes it;
- line [1, px, py, pz, vx, vy, vz, yaw];
- harmonic [2, heading, 0, 0, 0, 0, 0, yaw]: one sine for each axis, whose row of the table (3, 4) is
  centre, amplitude, rate, phase;
- piecewise [3, heading, period, 0, 0, 0, 0, yaw]: polynomials of x, y, z and yaw; a period above 0 repeats them. A row
  of the table (S, 33) holds for one interval: its first time [s], then eight coefficients of each channel, the highest
  power first, of the time since the row began. The last row holds for ever.

`heading` is HEADING_*: fixed to `yaw`, along the path, or from the table.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, store3
from ptnsbc_core.kernel import formula, inline_kernel, kernel, prepared
from ptnsbc_core.types import (
    HEADING_PATH,
    HEADING_TABLE,
    TRAJECTORY_CIRCLE,
    TRAJECTORY_LINE,
    TRAJECTORY_PIECEWISE,
    Array,
    Trajectory,
    Vector3,
)

COEFFICIENTS = 8
"""Of one polynomial: degree 7, which a curve of minimum snap has."""

_STILL = 1e-12
"""Square of a horizontal speed [m^2/s^2] below which a path has no direction."""


class Reference(NamedTuple):
    """Desired state of the leader at one time, world ENU."""

    position: Vector3  # [m]
    velocity: Vector3  # [m/s]
    yaw: float  # [rad]
    acceleration: Vector3  # [m/s^2]


class Jet(NamedTuple):
    """A function of time at one time, and its derivatives."""

    value: float
    first: float  # [1/s]
    second: float  # [1/s^2]
    third: float  # [1/s^3]


class Heading(NamedTuple):
    """Desired heading of the leader at one time."""

    angle: float  # [rad] from east, counter-clockwise
    rate: float  # [rad/s]
    acceleration: float  # [rad/s^2]


class CurveState(NamedTuple):
    """The curve at one time with what is needed to turn with it, world ENU."""

    position: Vector3  # [m]
    velocity: Vector3  # [m/s]
    acceleration: Vector3  # [m/s^2]
    jerk: Vector3  # [m/s^3]
    heading: Heading


@inline_kernel
def row_at(table: Array, t: float) -> int:
    """The row that holds at t [s], by bisection; the first one before all of them."""
    low, high = 0, table.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@formula
def polynomial(table: Array, row: int, channel: int, t: float) -> Jet:
    """One channel of a row at t [s], by Horner's rule."""
    since = t - table[row, 0]
    first = 1 + COEFFICIENTS * channel
    value, slope, bend, twist = 0.0, 0.0, 0.0, 0.0
    for k in range(COEFFICIENTS):
        twist = twist * since + bend
        bend = bend * since + slope
        slope = slope * since + value
        value = value * since + table[row, first + k]
    return Jet(value, slope, 2.0 * bend, 6.0 * twist)


@inline_kernel
def _along(velocity: Vector3, acceleration: Vector3, jerk: Vector3, yaw: float) -> Heading:
    """Heading of a horizontal velocity; `yaw` where there is none."""
    square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    if square < _STILL:
        return Heading(yaw, 0.0, 0.0)
    turn = velocity[0] * acceleration[1] - velocity[1] * acceleration[0]
    rate = turn / square
    change = velocity[0] * jerk[1] - velocity[1] * jerk[0]
    growth = 2.0 * (velocity[0] * acceleration[0] + velocity[1] * acceleration[1])
    return Heading(math.atan2(velocity[1], velocity[0]), rate, (change - rate * growth) / square)


@formula
def _harmonic(table: Array, axis: int, t: float) -> tuple[float, float, float, float]:
    """One axis of a harmonic curve and its first three derivatives."""
    amplitude, rate = table[axis, 1], table[axis, 2]
    angle = rate * t + table[axis, 3]
    across, along = amplitude * math.sin(angle), amplitude * rate * math.cos(angle)
    return table[axis, 0] + across, along, -rate * rate * across, -rate * rate * along


@kernel
def _state_by_table(trajectory: Trajectory, t: float) -> CurveState:
    """The curve of a kind that has a table."""
    numbers, table = trajectory.numbers, trajectory.table
    yaw = Heading(numbers[7], 0.0, 0.0)
    if int(numbers[0]) == TRAJECTORY_PIECEWISE:
        period = numbers[2]
        since = t % period if period > 0.0 else max(t, 0.0)
        row = row_at(table, since)
        x, y = polynomial(table, row, 0, since), polynomial(table, row, 1, since)
        z = polynomial(table, row, 2, since)
        position, velocity = (x.value, y.value, z.value), (x.first, y.first, z.first)
        acceleration, jerk = (x.second, y.second, z.second), (x.third, y.third, z.third)
        if int(numbers[1]) == HEADING_TABLE:
            turn = polynomial(table, row, 3, since)
            yaw = Heading(turn.value, turn.first, turn.second)
    else:
        east, north, up = _harmonic(table, 0, t), _harmonic(table, 1, t), _harmonic(table, 2, t)
        position, velocity = (east[0], north[0], up[0]), (east[1], north[1], up[1])
        acceleration, jerk = (east[2], north[2], up[2]), (east[3], north[3], up[3])
    if int(numbers[1]) == HEADING_PATH:
        yaw = _along(velocity, acceleration, jerk, numbers[7])
    return CurveState(position, velocity, acceleration, jerk, yaw)


@kernel
def reference(trajectory: Trajectory, t: float) -> Reference:
    """Desired state at t [s] since the first epoch."""
    numbers = trajectory.numbers
    kind = int(numbers[0])
    x, y, z = numbers[1], numbers[2], numbers[3]
    if kind == TRAJECTORY_CIRCLE:
        radius, rate = numbers[4], numbers[5]
        angle = rate * t + numbers[6]
        sine, cosine = math.sin(angle), math.cos(angle)
        along = (radius * rate * cosine, -radius * rate * sine, 0.0)
        inward = -radius * rate * rate
        return Reference(
            (x + radius * sine, y + radius * cosine, z),
            along,
            numbers[7],
            (inward * sine, inward * cosine, 0.0),
        )
    if kind == TRAJECTORY_LINE:
        along = (numbers[4], numbers[5], numbers[6])
        return Reference(axpy(t, along, (x, y, z)), along, numbers[7], (0.0, 0.0, 0.0))
    at = _state_by_table(trajectory, t)
    return Reference(at.position, at.velocity, at.heading.angle, at.acceleration)


@kernel
def curve_state(trajectory: Trajectory, t: float) -> CurveState:
    """The curve at t [s] since the first epoch, to its third derivative, and its heading to the second."""
    numbers = trajectory.numbers
    kind = int(numbers[0])
    if kind != TRAJECTORY_CIRCLE and kind != TRAJECTORY_LINE:
        return _state_by_table(trajectory, t)
    at = reference(trajectory, t)
    jerk = (0.0, 0.0, 0.0)
    if kind == TRAJECTORY_CIRCLE:
        square = numbers[5] * numbers[5]
        jerk = (-square * at.velocity[0], -square * at.velocity[1], 0.0)
    return CurveState(at.position, at.velocity, at.acceleration, jerk, Heading(at.yaw, 0.0, 0.0))


def curve_samples(trajectory: Trajectory, times: Array) -> Array:
    """`curve_state` at times (T,) [s]: (T, 15), the fields in their order."""
    given = (trajectory, np.ascontiguousarray(times), np.empty((len(times), 15)))
    prepared(_sample, *given)(*given)
    return given[-1]


@kernel
def _sample(trajectory: Trajectory, times: Array, out: Array) -> None:
    for k in range(times.shape[0]):
        at = curve_state(trajectory, times[k])
        store3(out[k], 0, at.position)
        store3(out[k], 3, at.velocity)
        store3(out[k], 6, at.acceleration)
        store3(out[k], 9, at.jerk)
        heading = at.heading
        store3(out[k], 12, (heading.angle, heading.rate, heading.acceleration))
