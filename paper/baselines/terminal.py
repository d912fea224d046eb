"""Predefined-time sliding-mode control without a time base, for the paper's plant (docs/notes/baselines.md).

    e = x - x_d,  s = e_dot + phi_1(e),  a = x_d_ddot - phi_1'(e) e_dot - phi_2(s) - k sat(s / width)

for the position in world axes and for the Euler angles. s is zero after T_2 at the latest and e after another T_1,
so the deadline is T_1 + T_2. Mass and inertia are known, the leader's state is the estimate that our laws use,
a follower's place is the estimate and its offset. There is no avoidance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from paper.baselines.reaching import Reaching, phi, slope
from ptnsbc_core.algebra import (
    add3,
    cross3,
    div3,
    hadamard3,
    load3,
    matvec_transposed,
    norm3,
    saturation,
    scale3,
    sub3,
    wrap_angle,
)
from ptnsbc_core.control.rigid_body_control import saturate_force, saturate_torque
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.estimator import leader_estimate
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import (
    body_rates,
    euler_from_rotation,
    euler_rates,
    rotation,
    velocity_enu,
)
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    MODE_FORMATION,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Estimate,
    NeighbourMotion,
    OdometryLike,
    Vector3,
)


class Axis(NamedTuple):
    """The law of one kind of axis."""

    sliding: Reaching  # phi_1
    reaching: Reaching  # phi_2
    robust: float  # k [m/s^2] or [rad/s^2], above the disturbances
    width: float  # [m/s] or [rad/s]


class Terminal(NamedTuple):
    """The law of one UAV."""

    place: Vector3  # [m, ENU] desired position relative to the leader
    position: Axis
    attitude: Axis


class Desired(NamedTuple):
    """Desired state of a UAV."""

    position: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s]
    acceleration: Vector3  # [m/s^2]
    yaw: float  # [rad]


@inline_kernel
def _demanded_axis(error: float, rate: float, forward: float, axis: Axis) -> float:
    s = rate + phi(error, axis.sliding)
    steer = slope(error, axis.sliding) * rate + phi(s, axis.reaching)
    return forward - steer - axis.robust * saturation(s, axis.width)


@kernel
def demanded(error: Vector3, rate: Vector3, forward: Vector3, axis: Axis) -> Vector3:
    """Acceleration for an error, its rate and that of the reference."""
    return (
        _demanded_axis(error[0], rate[0], forward[0], axis),
        _demanded_axis(error[1], rate[1], forward[1], axis),
        _demanded_axis(error[2], rate[2], forward[2], axis),
    )


@kernel
def desired(
    estimate: Estimate,
    heard: bool,
    own: OdometryLike,
    clock: Clock,
    config: AgentConfig,
    place: Vector3,
) -> Desired:
    """The leader's trajectory, or the offset from the estimated leader; without an estimate the present position."""
    still = (0.0, 0.0, 0.0)
    if config.leader:
        now = reference(config.trajectory, clock.start_t)
        later = reference(config.trajectory, clock.start_t + clock.dt)
        acceleration = div3(sub3(later.velocity, now.velocity), clock.dt)
        return Desired(now.position, now.velocity, acceleration, now.yaw)
    if not heard:
        return Desired(load3(own, 0), still, still, 0.0)
    return Desired(add3(estimate.position, place), estimate.velocity, still, estimate.yaw)


@kernel
def turning_forward(euler: Vector3, rates: Vector3) -> Vector3:
    """d/dt(W^-1) euler_dot: the part of the body rates' derivative that is not W^-1 euler_ddot."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    st, ct = math.sin(euler[1]), math.cos(euler[1])
    p, q, r = rates[0], rates[1], rates[2]
    return (
        -ct * q * r,
        -sf * p * q + (cf * p * ct - sf * st * q) * r,
        -cf * p * q - (sf * p * ct + cf * st * q) * r,
    )


@kernel
def torque_for(own: OdometryLike, yaw: float, law: Axis, inertia: Vector3) -> Vector3:
    """Torque [N m, FLU] that levels the body and turns it to the heading."""
    euler = euler_from_rotation(rotation(own, 3))
    rates = load3(own, 10)
    turning = euler_rates(euler, rates)
    error = (euler[0], euler[1], wrap_angle(euler[2] - yaw))
    wanted = body_rates(euler, demanded(error, turning, (0.0, 0.0, 0.0), law))
    extra = turning_forward(euler, turning)
    gyroscopic = cross3(rates, hadamard3(inertia, rates))
    return add3(gyroscopic, hadamard3(inertia, add3(wanted, extra)))


@kernel
def terminal_step(
    state: AgentState,
    inputs: AgentInputs,
    t: float,
    dt: float,
    config: AgentConfig,
    law: Terminal,
) -> tuple[AgentState, AgentOutputs]:
    """One tick, as `ptnsbc_core.step.step`: pure, the same inputs and outputs."""
    clock = Clock(t, inputs.start_age_s, dt)
    leader = NeighbourMotion(
        velocity_enu(inputs.leader), 0.0, (0.0, 0.0, 0.0)
    )  # as it measures itself
    estimate, heard = leader_estimate(state, inputs, leader, clock, False, config)
    goal = desired(estimate, heard, inputs.own, clock, config, law.place)
    error = sub3(load3(inputs.own, 0), goal.position)
    rate = sub3(velocity_enu(inputs.own), goal.velocity)
    plant = config.controller
    asked = demanded(error, rate, goal.acceleration, law.position)
    asked = add3(asked, (0.0, 0.0, plant.gravity))
    body = matvec_transposed(rotation(inputs.own, 3), asked)
    force = saturate_force(scale3(plant.nominal.mass, body), plant)
    turn = torque_for(inputs.own, goal.yaw, law.attitude, plant.nominal.inertia)
    torque = saturate_torque(turn, plant)
    after = AgentState(
        estimate,
        heard,
        state.velocity,
        state.rates,
        state.adapted,
        state.obstacle_memory,
        state.start,
        state.recovery,
        state.standing_s,
        state.motions,
        state.hold,
        MODE_FORMATION,
        t,
    )
    saturated = force.saturated or torque.saturated
    away = scale3(-1.0, error)
    diagnostics = AgentDiagnostics(away, 0.0, 1.0, 0, saturated, False, 0.0, norm3(rate), False)
    reported = load3(inputs.own, 7)
    outputs = AgentOutputs(
        goal.velocity, 0.0, force.value, torque.value, estimate, heard, reported, diagnostics
    )
    return after, outputs
