"""Behaviours of one UAV: leader tracking, formation, attitude, and their composition with clearance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import (
    dot3,
    limited,
    minus,
    moved,
    norm3,
    plus,
    put3,
    scaled,
    times,
    wrap,
)
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import body_rates, euler_from_rotation, rotation
from ptnsbc_core.nullspace import compose, damped_solve, scaled_to_limit
from ptnsbc_core.tasks.clearance import ClearanceTask
from ptnsbc_core.tasks.registry import evaluate, task_error
from ptnsbc_core.timebase import Clock, holding_gain, loop_rate, onset
from ptnsbc_core.trajectory import Reference
from ptnsbc_core.types import AgentConfig, Array, Vector3


class Behaviour(NamedTuple):
    """Velocity that one behaviour asks for, and how it stands with the task it comes from."""

    velocity: Vector3  # [m/s, ENU]
    error: Vector3  # sigma_d - sigma, the task's own units
    singular_value: float


class EpochErrors(NamedTuple):
    """Errors at the epoch, from which the profile `reference` plans; `now` at the tick that arms."""

    now: bool
    task: Vector3
    attitude: Vector3  # [rad]


class Neighbour(NamedTuple):
    """Position and velocity of another UAV, moved on to the present."""

    position: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s, ENU]


@kernel
def leader_tracking(
    position: Vector3, desired: Reference, armed: EpochErrors, clock: Clock, config: AgentConfig
) -> Behaviour:
    """Leader tracking, missing in the paper: sigma = p_1, J = I, p_dot = c p_r_dot + Lambda G (p_r - p_1).

    c(t) keeps the feed-forward of a trajectory that is already moving at t = 0 from being a step; what it
    leaves out is gone at tf, where the gain still is.
    """
    error = minus(desired.position, position)
    start = error if armed.now else armed.task
    rate = loop_rate(config.formation, error, start, clock)
    forward = moved(rate, onset(config.formation, clock), desired.velocity)
    return Behaviour(forward, error, 1.0)


@kernel
def formation(
    position: Vector3,
    parent: Neighbour,
    leader: Neighbour,
    armed: EpochErrors,
    clock: Clock,
    config: AgentConfig,
) -> Behaviour:
    """Formation law, in place of (30): v_L + J^+ [Lambda G e - J_j (v_j - v_L)].

    The reference k is the leader's estimated position plus the anchor and moves with v_L, so its own term
    vanishes. v_L stays outside the pseudo-inverse: damping must not slow the feed-forward. Where (23) is
    close to singular (UAV 4 starts so in Table 2), the directions it cannot steer follow the desired offset
    from the parent, as a task below it in its null space.
    """
    reference = plus(leader.position, config.anchor)
    geometry = evaluate(config.task, position, parent.position, reference)
    error = task_error(geometry, config.desired)
    start = error if armed.now else armed.task
    rate = loop_rate(config.formation, error, start, clock)
    relative = minus(parent.velocity, leader.velocity)
    left = minus(rate, times(geometry.parent, relative))
    scale = config.row_scale
    asked = (scale[0] * left[0], scale[1] * left[1], scale[2] * left[2])
    own = geometry.own
    jacobian = (scaled(scale[0], own[0]), scaled(scale[1], own[1]), scaled(scale[2], own[2]))
    behind = minus(config.offset, minus(position, parent.position))
    fallback = moved(relative, holding_gain(config.formation, clock), behind)
    solved = damped_solve(jacobian, asked, fallback, config.damping_threshold, config.damping_max)
    return Behaviour(plus(leader.velocity, solved.velocity), error, solved.singular_value)


@leaf
def hold(position: Vector3, where: Vector3, config: AgentConfig) -> Vector3:
    """Velocity [m/s, ENU] that keeps a place, within the speed limit."""
    return limited(scaled(config.hold_gain, minus(where, position)), 0.5 * config.filter.max_speed)


@kernel
def attitude(
    own: Array, yaw: float, armed: EpochErrors, clock: Clock, config: AgentConfig
) -> tuple[Vector3, Vector3]:
    """Attitude behaviour of the 6-DOF plant, missing in the paper: w = W^-1 Lambda G (beta_d - beta).

    Returns the body rates [rad/s] and the Euler error [rad]; beta_d = (0, 0, yaw).
    """
    euler = euler_from_rotation(rotation(own, 3))
    error = (-euler[0], -euler[1], wrap(yaw - euler[2]))
    start = error if armed.now else armed.attitude
    rate = loop_rate(config.attitude, error, start, clock)
    return body_rates(euler, rate), error


class ComposedVelocity(NamedTuple):
    """Velocity after composition and the speed limit."""

    velocity: Vector3  # [m/s, ENU]
    limited: bool
    violation: float  # [m/s] how far the sum, cut to the speed limit, misses the top task's rows


@leaf
def composed(top: ClearanceTask, max_speed: float) -> ComposedVelocity:
    """Clearance first, the behaviour below it in its null space, within the speed limit [m/s]."""
    if top.jacobian.shape[0] == 0:
        free = limited(top.below, max_speed)
        return ComposedVelocity(free, norm3(top.below) > max_speed, 0.0)
    return _composed_below(top, max_speed)


@kernel
def _composed_below(top: ClearanceTask, max_speed: float) -> ComposedVelocity:
    above = top.jacobian.shape[0]
    velocities = np.empty((2, 3))
    put3(velocities[0], 0, top.velocity)
    put3(velocities[1], 0, top.below)
    rows = np.empty(2)
    rows[0], rows[1] = above, 3
    parts = compose(velocities, top.jacobian, rows)
    out = scaled_to_limit(parts, max_speed)
    cut = minus(plus(parts[0], parts[1]), out)
    whole = max(abs(cut[0]), abs(cut[1]), abs(cut[2]))
    change = 0.0
    missed = minus(out, top.velocity)
    for row in range(above):
        change = max(change, abs(dot3(top.jacobian[row], missed)))
    return ComposedVelocity(out, whole > 1e-9, change)
