"""Predefined-time sliding-mode control without a time base, for the paper's plant (equations.md section 8).

    e = x - x_d,  s = e_dot + phi_1(e),  a = x_d_ddot - phi_1'(e) e_dot - phi_2(s) - k sat(s / width)

for the position in world axes and for the Euler angles. s is zero after T_2 at the latest and e after another T_1,
so the deadline is T_1 + T_2. Mass and inertia are known, the leader's state is the estimate that our laws use,
a follower's place is the estimate and its offset. There is no avoidance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import cross3, norm3, put, saturation, transpose_times, wrap
from ptnsbc_core.controller import limit_wrench
from ptnsbc_core.estimator import estimated_leader
from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import (
    body_rates,
    estimate_to_odometry,
    euler_from_rotation,
    euler_rates,
    rotation_from_quaternion,
    velocity_enu,
)
from ptnsbc_core.timebase import Clock
from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import (
    MODE_FORMATION,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
)
from ptnsbc_sim.baselines.reaching import Reaching, phi, slope


class Axis(NamedTuple):
    """The law of one kind of axis."""

    sliding: Reaching  # phi_1
    reaching: Reaching  # phi_2
    robust: float  # k [m/s^2] or [rad/s^2], above the disturbances
    width: float  # [m/s] or [rad/s]


class Terminal(NamedTuple):
    """The law of one UAV."""

    place: Array  # (3,) [m, ENU] desired position relative to the leader
    position: Axis
    attitude: Axis


class Desired(NamedTuple):
    """Where a UAV should be."""

    position: Array  # (3,) [m, ENU]
    velocity: Array  # (3,) [m/s]
    acceleration: Array  # (3,) [m/s^2]
    yaw: float  # [rad]


@kernel
def demanded(error: Array, rate: Array, forward: Array, axis: Axis) -> Array:
    """Acceleration (3,) for an error (3,), its rate (3,) and that of the reference (3,)."""
    out = np.empty(3)
    for i in range(3):
        s = rate[i] + phi(error[i], axis.sliding)
        steer = slope(error[i], axis.sliding) * rate[i] + phi(s, axis.reaching)
        out[i] = forward[i] - steer - axis.robust * saturation(s, axis.width)
    return out


@kernel
def desired(
    estimate: Array, heard: bool, own: Array, clock: Clock, config: AgentConfig, place: Array
) -> Desired:
    """The leader's trajectory, or the place beside the leader's estimate; before it is heard of: here."""
    still = np.zeros(3)
    if config.leader:
        now = reference(config.trajectory, clock.start_t)
        later = reference(config.trajectory, clock.start_t + clock.dt)
        acceleration = np.empty(3)
        for i in range(3):
            acceleration[i] = (later.velocity[i] - now.velocity[i]) / clock.dt
        return Desired(now.position, now.velocity, acceleration, now.yaw)
    if not heard:
        return Desired(own[0:3].copy(), still, still, 0.0)
    position = np.empty(3)
    for i in range(3):
        position[i] = estimate[i] + place[i]
    return Desired(position, estimate[3:6].copy(), still, float(estimate[6]))


@kernel
def turning_forward(euler: Array, rates: Array) -> Array:
    """(3,) d/dt(W^-1) euler_dot: what body rates need beside W^-1 euler_ddot, at Euler rates (3,)."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    st, ct = math.sin(euler[1]), math.cos(euler[1])
    p, q, r = rates[0], rates[1], rates[2]
    out = np.empty(3)
    out[0] = -ct * q * r
    out[1] = -sf * p * q + (cf * p * ct - sf * st * q) * r
    out[2] = -cf * p * q - (sf * p * ct + cf * st * q) * r
    return out


@kernel
def torque_for(own: Array, yaw: float, law: Axis, inertia: Array) -> Array:
    """Torque (3,) [N m, FLU] that levels the body and turns it to the heading."""
    euler = euler_from_rotation(rotation_from_quaternion(own[3:7]))
    rates = own[10:13].copy()
    turning = euler_rates(euler, rates)
    error = euler.copy()
    error[2] = wrap(euler[2] - yaw)
    still = np.zeros(3)
    wanted = body_rates(euler, demanded(error, turning, still, law))
    extra = turning_forward(euler, turning)
    momentum = np.empty(3)
    for i in range(3):
        momentum[i] = inertia[i] * rates[i]
    out = cross3(rates, momentum)
    for i in range(3):
        out[i] += inertia[i] * (wanted[i] + extra[i])
    return out


@kernel
def terminal_step(
    state: AgentState,
    inputs: AgentInputs,
    t: float,
    dt: float,
    config: AgentConfig,
    law: Terminal,
) -> tuple[AgentState, AgentOutputs]:
    """One tick, as `ptnsbc_core.agent.step`: pure, the same inputs and outputs."""
    clock = Clock(t, inputs.start_age_s, dt)
    estimate, heard = estimated_leader(state, inputs, clock, False, config)
    goal = desired(estimate, heard, inputs.own, clock, config, law.place)
    speed = velocity_enu(inputs.own)
    error, rate = np.empty(3), np.empty(3)
    for i in range(3):
        error[i] = inputs.own[i] - goal.position[i]
        rate[i] = speed[i] - goal.velocity[i]
    force = demanded(error, rate, goal.acceleration, law.position)
    force[2] += config.controller.gravity
    body = transpose_times(rotation_from_quaternion(inputs.own[3:7]), force)
    wrench = np.empty(6)
    for i in range(3):
        wrench[i] = config.controller.nominal[0] * body[i]
    put(wrench, 3, torque_for(inputs.own, goal.yaw, law.attitude, config.controller.nominal[1:4]))
    saturated = limit_wrench(wrench, config.controller)
    after = AgentState(
        estimate,
        heard,
        state.command,
        state.parameters,
        state.bound,
        state.observer,
        state.encounters,
        state.start_error,
        state.hold,
        MODE_FORMATION,
        t,
    )
    told = np.zeros(4)
    put(told, 0, goal.velocity)
    diagnostics = AgentDiagnostics(-error, 0.0, 1.0, 0, saturated, False, 0.0, norm3(rate))
    return after, AgentOutputs(told, wrench, estimate_to_odometry(estimate), diagnostics)
