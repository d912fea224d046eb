"""Behaviours of one UAV: leader tracking, formation, attitude, and their composition with clearance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import limited, minus, moved, norm3, plus, put, scaled, times, wrap
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import body_rates, euler_from_rotation, rotation_from_quaternion
from ptnsbc_core.nullspace import compose, damped_solve, scaled_to_limit
from ptnsbc_core.tasks.clearance import Clearance
from ptnsbc_core.tasks.registry import evaluate, task_error
from ptnsbc_core.timebase import Clock, holding_gain, loop_rate, onset
from ptnsbc_core.trajectory import Reference
from ptnsbc_core.types import AgentConfig, Array


class Behaviour(NamedTuple):
    """Velocity that one behaviour asks for, and the task it comes from."""

    velocity: Array  # (3,) [m/s, ENU]
    jacobian: Array  # (3, 3) scaled rows
    error: Array  # (3,) sigma_d - sigma, the task's own units
    singular_value: float


class Armed(NamedTuple):
    """Errors at the epoch, from which the profile `reference` plans; `now` at the tick that arms."""

    now: bool
    task: Array  # (3,)
    attitude: Array  # (3,) [rad]


class Neighbour(NamedTuple):
    """Position and velocity of another UAV, moved on to the present."""

    position: Array  # (3,) [m, ENU]
    velocity: Array  # (3,) [m/s, ENU]


@kernel
def leader_tracking(
    position: Array, reference: Reference, armed: Armed, clock: Clock, config: AgentConfig
) -> Behaviour:
    """Leader tracking, missing in the paper: sigma = p_1, J = I, p_dot = c p_r_dot + Lambda G (p_r - p_1).

    c(t) keeps the feed-forward of a trajectory that is already moving at t = 0 from being a step; what it
    leaves out is gone at tf, where the gain still is.
    """
    error = minus(reference.position, position)
    start = error if armed.now else armed.task
    rate = loop_rate(config.formation, error, start, clock)
    jacobian = np.zeros((3, 3))
    for i in range(3):
        jacobian[i, i] = 1.0
    forward = moved(rate, onset(config.formation, clock), reference.velocity)
    return Behaviour(forward, jacobian, error, 1.0)


@kernel
def formation(
    position: Array,
    parent: Neighbour,
    leader: Neighbour,
    armed: Armed,
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
    drift = times(geometry.parent, relative)
    jacobian = np.empty((3, 3))
    asked = np.empty(3)
    for row in range(3):
        scale = config.row_scale[row]
        asked[row] = scale * (rate[row] - drift[row])
        for i in range(3):
            jacobian[row, i] = scale * geometry.own[row, i]
    behind = minus(config.offset, minus(position, parent.position))
    fallback = moved(relative, holding_gain(config.formation, clock), behind)
    solved = damped_solve(jacobian, asked, fallback, config.damping_threshold, config.damping_max)
    return Behaviour(plus(leader.velocity, solved.velocity), jacobian, error, solved.singular_value)


@leaf
def hold(position: Array, where: Array, config: AgentConfig) -> Array:
    """Velocity (3,) [m/s, ENU] that keeps a place (4,), within the speed limit."""
    return limited(scaled(config.hold_gain, minus(where, position)), 0.5 * config.filter.max_speed)


@kernel
def attitude(
    own: Array, yaw: float, armed: Armed, clock: Clock, config: AgentConfig
) -> tuple[Array, Array]:
    """Attitude behaviour of the 6-DOF plant, missing in the paper: w = W^-1 Lambda G (beta_d - beta).

    Returns the body rates (3,) [rad/s] and the Euler error (3,) [rad]; beta_d = (0, 0, yaw).
    """
    euler = euler_from_rotation(rotation_from_quaternion(own[3:7]))
    error = np.empty(3)
    error[0], error[1], error[2] = -euler[0], -euler[1], wrap(yaw - euler[2])
    start = error if armed.now else armed.attitude
    rate = loop_rate(config.attitude, error, start, clock)
    return body_rates(euler, rate), error


class Composed(NamedTuple):
    """Velocity after composition and the speed limit."""

    velocity: Array  # (3,) [m/s, ENU]
    limited: bool
    violation: float  # [m/s] how far the sum, cut to the speed limit, misses the top task's rows


@kernel
def composed(top: Clearance, jacobian: Array, max_speed: float) -> Composed:
    """Clearance first, the behaviour below it in its null space, within the speed limit [m/s]."""
    above = top.jacobian.shape[0]
    if above == 0:
        free = limited(top.below, max_speed)
        return Composed(free, norm3(top.below) > max_speed, 0.0)
    velocities = np.empty((2, 3))
    put(velocities[0], 0, top.velocity)
    put(velocities[1], 0, top.below)
    stacked = np.empty((above + 3, 3))
    for row in range(above):
        put(stacked[row], 0, top.jacobian[row])
    for row in range(3):
        put(stacked[above + row], 0, jacobian[row])
    rows = np.empty(2)
    rows[0], rows[1] = above, 3
    parts = compose(velocities, stacked, rows)
    out = scaled_to_limit(parts, max_speed)
    change = 0.0
    whole = 0.0
    for i in range(3):
        whole = max(whole, abs(parts[0, i] + parts[1, i] - out[i]))
    for row in range(above):
        miss = 0.0
        for i in range(3):
            miss += top.jacobian[row, i] * (out[i] - top.velocity[i])
        change = max(change, abs(miss))
    return Composed(out, whole > 1e-9, change)
