"""One control step of one UAV: estimator, behaviours, null-space, command filter, controller.

`step` is the only place where the laws meet. The headless swarm calls it, and by way of `agent` the processes
and every replay.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import three, wrap
from ptnsbc_core.control.adaptation import started
from ptnsbc_core.control.command_filter import filter_step
from ptnsbc_core.control.quadrotor_control import quadrotor_control
from ptnsbc_core.control.rigid_body_control import (
    ControlInput,
    VelocityReference,
    rigid_body_control,
)
from ptnsbc_core.estimator import estimated_leader
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import state_to_estimate, velocity_enu, yaw_of
from ptnsbc_core.mission import behaviour_of_mission, desired_yaw, held, hold_place, lost
from ptnsbc_core.planner import Behaviour, EpochErrors, attitude, composed
from ptnsbc_core.tasks.clearance import ObstacleView, clearance
from ptnsbc_core.tasks.encounters import none_met
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_HOLD,
    PLANT_RIGID_BODY,
    AdaptationState,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
    PoseTarget,
    Vector3,
)

_NOT_YET = -1


@kernel
def initial_state(own: Array, config: AgentConfig) -> AgentState:
    """State before the first tick, from the UAV's own odometry vector (13,)."""
    velocity, zero = velocity_enu(own), (0.0, 0.0, 0.0)
    return AgentState(
        state_to_estimate(own),
        False,
        velocity,
        zero,
        AdaptationState(config.controller.nominal, (0.0, 0.0), started(velocity)),
        none_met(),
        zero,
        zero,
        PoseTarget(three(own, 0), yaw_of(own)),
        _NOT_YET,
        0.0,
    )


@leaf
def _controlled(
    state: AgentState,
    inputs: AgentInputs,
    command: VelocityReference,
    clock: Clock,
    config: AgentConfig,
) -> ControlInput:
    """Force and torque by the law of the plant's kind."""
    inner = Clock(clock.start_t, clock.start_t, clock.dt)  # inner loops arm once
    own, before, law = inputs.own, state.adapted, config.controller
    if law.plant == PLANT_RIGID_BODY:
        return rigid_body_control(own, command, before, inner, law)
    return quadrotor_control(own, command, before, inner, law, config.filter.max_rate)


class PlannerOutput(NamedTuple):
    """What the planner hands to the controller."""

    command: VelocityReference
    encounters: Array  # (8, 7)
    active_rows: int
    saturated: bool
    violation: float  # [m/s]


@leaf
def _planned(
    state: AgentState,
    inputs: AgentInputs,
    behaviour: Behaviour,
    rates: Vector3,
    yaw: float,
    dt: float,
    config: AgentConfig,
) -> PlannerOutput:
    """Clearance above the behaviour, the speed limit, and the command filter."""
    around = ObstacleView(inputs.near, inputs.near_age_s, state.encounters, dt)
    top = clearance(three(inputs.own, 0), behaviour.velocity, around, config.clearance)
    limits = config.filter
    wanted = composed(top, limits.max_speed)
    linear = filter_step(
        state.velocity, wanted.velocity, limits.bandwidth, limits.max_acceleration, dt
    )
    angular = filter_step(
        state.rates, rates, limits.rate_bandwidth, limits.max_rate_acceleration, dt
    )
    return PlannerOutput(
        VelocityReference(linear.value, linear.rate, angular.value, angular.rate, yaw),
        top.encounters,
        top.jacobian.shape[0],
        wanted.limited or linear.saturated,
        wanted.violation,
    )


@leaf
def _yaw_rate(inputs: AgentInputs, command: VelocityReference, config: AgentConfig) -> float:
    """Yaw rate setpoint [rad/s] for a vehicle that closes its own loops."""
    if config.controller.plant == PLANT_RIGID_BODY:
        return command.rates[2]
    off = wrap(command.yaw - yaw_of(inputs.own))
    most = config.filter.max_rate
    return min(max(config.controller.attitude_gain[1] * off, -most), most)


@kernel
def step(
    state: AgentState, inputs: AgentInputs, t: float, dt: float, config: AgentConfig
) -> tuple[AgentState, AgentOutputs]:
    """One tick: pure, no clock, no randomness, no I/O.

    Args:
        state: what the previous tick left (`initial_state` before the first).
        inputs: what the UAV knows now.
        t: time since the latest epoch [s].
        dt: control period [s].
        config: constants of this UAV.

    Returns:
        The state for the next tick and what to send now.
    """
    clock = Clock(t, inputs.start_age_s, dt)
    holding = inputs.mode != MODE_FORMATION or lost(inputs, clock.start_t, config)
    estimate, heard = estimated_leader(state, inputs, clock, holding, config)
    place = hold_place(state, inputs, holding)
    yaw = desired_yaw(estimate, place, holding, clock, config)

    arms = state.mode == _NOT_YET or t < state.last_t or state.heard != heard
    armed = EpochErrors(arms, state.start_error, state.start_attitude)
    behaviour = behaviour_of_mission(inputs, estimate, armed, clock, config)
    rates, euler_error = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if config.controller.plant == PLANT_RIGID_BODY:  # a quadrotor's attitude is its controller's
        rates, euler_error = attitude(inputs.own, yaw, armed, clock, config)
    start_error = behaviour.error if arms else state.start_error
    start_attitude = euler_error if arms else state.start_attitude
    if holding:
        behaviour = held(behaviour, inputs, place, config)

    planned = _planned(state, inputs, behaviour, rates, yaw, dt, config)
    command = planned.command
    control = _controlled(state, inputs, command, clock, config)
    after = AgentState(
        estimate,
        heard,
        command.velocity,
        command.rates,
        control.adapted,
        planned.encounters,
        start_error,
        start_attitude,
        place,
        max(inputs.mode, MODE_HOLD) if holding else MODE_FORMATION,
        t,
    )
    diagnostics = AgentDiagnostics(
        behaviour.error,
        loop_gain(config.formation, clock),
        behaviour.singular_value,
        planned.active_rows,
        planned.saturated or control.saturated,
        holding,
        planned.violation,
        control.velocity_error,
    )
    yaw_rate = _yaw_rate(inputs, command, config)
    outputs = AgentOutputs(
        command.velocity, yaw_rate, control.force, control.torque, estimate, diagnostics
    )
    return after, outputs
