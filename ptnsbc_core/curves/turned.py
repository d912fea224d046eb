"""The planned approach of a follower, straight or turned about the vertical, and what others can tell from it.

The straight plan of the error beside the leader is E(t) = (1 - h) E_0. The turned plan is
E(t) = (1 - h) R_z(phi) E_0. The angle phi rises from 0 to the turn alpha, which all UAVs share. With horizontal
vectors as complex numbers the plan is z E_0, with z = (1 - h) e^(i phi); the vertical component keeps 1 - h. |E| is the
same with every turn, see docs/notes/slots.md ("The turn").

So the formation announces the paths of all UAVs: they fly to their slots by one time profile. A UAV is at
x = g + z (x_0 - g) beside the leader, with its slot g. Its velocity there is x_dot = -z_dot / z (g - x): where it goes
can be read from where it is and how fast it flies. Positions [m] and velocities [m/s] are world ENU,
docs/notes/clearance.md ("Told paths").
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, load3, norm3, scale3, sub3
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.timebase import Clock, h, h_rate, plan_step
from ptnsbc_core.types import Array, Vector3, Vector3Like

TURNED = 0.75
"""Share of the plan's duration after which the turn is complete."""

_STILL = 1e-12

REACH = 3
"""Column of the slots: half of the distance to the next slot [m]."""

_LEAST_RATE = 1e-6


class Factor(NamedTuple):
    """A factor of vectors: a complex number for the horizontal part, a real one for the vertical part."""

    along: float
    across: float
    up: float


@inline_kernel
def plus_scaled(sign: float, factor: Factor, x: Vector3Like, base: Vector3Like) -> Vector3:
    """`base` + sign * factor * x; by `axpy`, to the last bit, where the factor is one number for all axes."""
    if factor.across == 0.0 and factor.along == factor.up:
        return axpy(sign * factor.up, x, base)
    along, across = sign * factor.along, sign * factor.across
    return (
        base[0] + along * x[0] - across * x[1],
        base[1] + across * x[0] + along * x[1],
        base[2] + sign * factor.up * x[2],
    )


@inline_kernel
def scaled(factor: Factor, x: Vector3Like) -> Vector3:
    """factor * x."""
    if factor.across == 0.0 and factor.along == factor.up:
        return scale3(factor.up, x)
    return (
        factor.along * x[0] - factor.across * x[1],
        factor.across * x[0] + factor.along * x[1],
        factor.up * x[2],
    )


@inline_kernel
def turn_share(s: float) -> float:
    """phi / alpha [1] at s = t / T [1]: rises from 0 to 1, its first two derivatives vanish at both ends."""
    x = min(max(s / TURNED, 0.0), 1.0)
    return ((6.0 * x - 15.0) * x + 10.0) * x * x * x


@inline_kernel
def turn_share_rate(s: float) -> float:
    """Derivative [1] of `turn_share` by s."""
    x = min(max(s / TURNED, 0.0), 1.0)
    y = x * (1.0 - x)
    return 30.0 * y * y / TURNED


@inline_kernel
def left_at(turn: float, s: float) -> Factor:
    """z at s = t / T [1]: the share of the start error that is left."""
    left, angle = 1.0 - h(s), turn * turn_share(s)
    return Factor(left * math.cos(angle), left * math.sin(angle), left)


class TurnedStep(NamedTuple):
    """The plan E(t) = z E_0 of one step, for E_0 = 1."""

    left: Factor  # z at the start of the step
    rate: Factor  # of 1 - z over the step [1/s]
    acceleration: Factor  # change of that rate to the next step [1/s^2]


@formula
def _straight(number: float) -> Factor:
    return Factor(number, 0.0, number)


@formula
def _change(now: Factor, then: Factor, up: float, dt: float) -> Factor:
    return Factor((now.along - then.along) / dt, (now.across - then.across) / dt, up)


@kernel
def turned_step(duration_s: float, turn: float, clock: Clock) -> TurnedStep:
    """The plan of `duration_s` with a turn [rad] at this tick; without a turn no sine is computed."""
    plan = plan_step(duration_s, clock)
    if turn == 0.0 or clock.t >= duration_s:
        return TurnedStep(_straight(plan.left), _straight(plan.rate), _straight(plan.acceleration))
    dt = clock.dt
    now = left_at(turn, clock.t / duration_s)
    then = left_at(turn, (clock.t + dt) / duration_s)
    after = left_at(turn, (clock.t + 2.0 * dt) / duration_s)
    rate = _change(now, then, plan.rate, dt)
    later = _change(then, after, plan.rate, dt)
    return TurnedStep(now, rate, _change(later, rate, plan.acceleration, dt))


@inline_kernel
def start_of(left: Factor, error: Vector3Like) -> Vector3:
    """Start error of the plan of which `error` is what is left."""
    if left.across == 0.0 and left.along == left.up:
        return scale3(1.0 / left.up, error)
    square = left.up * left.up
    inverse = Factor(left.along / square, -left.across / square, 1.0 / left.up)
    return scaled(inverse, error)


@inline_kernel
def goal_factor(turn: float, t: float, duration_s: float) -> Factor:
    """Factor [s] of the velocity of a UAV on its plan that leads from where it is to the plan's end: -z / z_dot."""
    left, rate = 1.0 - h(t / duration_s), h_rate(t / duration_s, duration_s)
    if turn == 0.0:
        return _straight(left / rate)
    bend = turn * turn_share_rate(t / duration_s) / duration_s * left
    square = rate * rate + bend * bend
    return Factor(left * rate / square, left * bend / square, left / rate)


@inline_kernel
def mean_factor(turn: float, t: float, duration_s: float, horizon_s: float) -> Factor:
    """Mean velocity over the horizon of a UAV on its plan, as a factor of its present velocity.

    No component is longer than 1: what speeds up counts with its present velocity, in the direction of the mean.
    """
    s, then_s = t / duration_s, (t + horizon_s) / duration_s
    now, rate = h(s), h_rate(s, duration_s)
    share = (h(then_s) - now) / (horizon_s * rate)
    up = min(share, 1.0)
    if turn == 0.0:
        return _straight(up)
    bend = turn * turn_share_rate(s) / duration_s * (1.0 - now)
    angle = turn * (turn_share(then_s) - turn_share(s))
    later = 1.0 - h(then_s)
    # (z_2 - z_1) / (H z_dot_1), both without e^(i phi_1)
    moved_x = later * math.cos(angle) - (1.0 - now)
    moved_y = later * math.sin(angle)
    square = horizon_s * max(rate * rate + bend * bend, _STILL)
    along = (moved_y * bend - moved_x * rate) / square
    across = -(moved_y * rate + moved_x * bend) / square
    longest = max(math.sqrt(along * along + across * across), 1.0)
    return Factor(along / longest, across / longest, up)


class ToldPaths(NamedTuple):
    """The paths of all UAVs, as one UAV knows them."""

    t: float  # since the epoch [s]
    duration_s: float  # of the planned approach; 0: nothing is planned
    leader_position: Vector3  # [m, ENU]
    leader_velocity: Vector3  # [m/s, ENU]
    slot: Vector3  # [m, ENU] of this UAV, relative to the leader
    slots: Array  # (N, 4) those of the others, and half of the distance to the next one [m]
    reach: float  # [m] half of the distance from the own slot to the next one
    turn: float  # [rad] of the planned approach


@inline_kernel
def _nearness(gap: float, reach: float) -> float:
    """1 up to half of the reach, 0 from the reach on."""
    return min(max(2.0 - 2.0 * gap / reach, 0.0), 1.0) if reach > 0.0 else 0.0


@inline_kernel
def _goal(told: ToldPaths, position: Vector3, velocity: Vector3, left: Factor) -> Vector3:
    """The end of the path of a UAV that flies so, relative to the leader."""
    place = sub3(position, told.leader_position)
    return plus_scaled(1.0, left, sub3(velocity, told.leader_velocity), place)


@kernel
def path_share(
    told: ToldPaths,
    own_position: Vector3,
    own_velocity: Vector3,
    position: Vector3,
    velocity: Vector3,
    horizon_s: float,
) -> Factor:
    """Part of the present relative velocity [1] that two UAVs have on average within the horizon.

    On their paths it is (z(t + H) - z(t)) / (H z_dot), no longer than 1. Off them, where one of the two does not
    fly towards a slot, it is 1. In between it is in proportion to how near their goals are to slots.
    """
    all_of_it = Factor(1.0, 0.0, 1.0)
    rate = h_rate(told.t / told.duration_s, told.duration_s) if told.duration_s > 0.0 else 0.0
    if rate < _LEAST_RATE:
        return all_of_it
    mean = mean_factor(told.turn, told.t, told.duration_s, horizon_s)
    if told.turn == 0.0 and mean.up >= 1.0:
        return all_of_it
    left = goal_factor(told.turn, told.t, told.duration_s)
    own = _goal(told, own_position, own_velocity, left)
    kept = _nearness(norm3(sub3(own, told.slot)), told.reach)
    if kept <= 0.0:
        return all_of_it
    goal = _goal(told, position, velocity, left)
    least, reach = np.inf, 0.0
    for row in range(told.slots.shape[0]):
        gap = norm3(sub3(goal, load3(told.slots[row], 0)))
        if gap < least:
            least, reach = gap, told.slots[row, REACH]
    kept *= _nearness(least, reach)
    up = 1.0 - kept * (1.0 - mean.up)
    if told.turn == 0.0:
        return Factor(up, 0.0, up)
    return Factor(1.0 - kept * (1.0 - mean.along), kept * mean.across, up)
