"""One control step of one UAV: estimator, behaviours, null-space, command filter, controller.

`step` is the only place where the laws meet. The headless swarm calls it, and by way of `agent` the processes
and every replay.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.adaptation import started
from ptnsbc_core.algebra import part, put, wrap
from ptnsbc_core.command_filter import filter_step
from ptnsbc_core.controller import Command, Control, rigid_body_control
from ptnsbc_core.estimator import estimated_leader
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import estimate_to_odometry, state_to_estimate, velocity_enu, yaw_of
from ptnsbc_core.mission import behaviour_of_mission, desired_yaw, held, hold_place, lost
from ptnsbc_core.planner import Armed, Behaviour, attitude, composed
from ptnsbc_core.quadrotor_control import quadrotor_control
from ptnsbc_core.tasks.clearance import clearance
from ptnsbc_core.tasks.encounters import none_met
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_HOLD,
    PLANT_RIGID_BODY,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
)

_NOT_YET = -1


@kernel
def initial_state(own: Array, config: AgentConfig) -> AgentState:
    """State before the first tick, from the UAV's own odometry vector (13,)."""
    hold_at = np.zeros(4)
    put(hold_at, 0, own[0:3])
    hold_at[3] = yaw_of(own)
    command = np.zeros(6)
    put(command, 0, velocity_enu(own))
    return AgentState(
        state_to_estimate(own),
        False,
        command,
        config.controller.nominal.copy(),
        np.zeros(2),
        started(velocity_enu(own)),
        none_met(),
        np.zeros(6),
        hold_at,
        _NOT_YET,
        0.0,
    )


@leaf
def _controlled(
    state: AgentState, inputs: AgentInputs, command: Command, clock: Clock, config: AgentConfig
) -> Control:
    """Wrench by the law of the plant's kind."""
    inner = Clock(clock.start_t, clock.start_t, clock.dt)  # inner loops arm once
    if config.controller.plant == PLANT_RIGID_BODY:
        return rigid_body_control(
            inputs.own,
            command,
            state.parameters,
            state.bound,
            inner,
            config.controller,
            state.observer,
        )
    return quadrotor_control(
        inputs.own,
        command,
        state.parameters,
        state.bound,
        inner,
        config.controller,
        state.observer,
        config.filter.max_rate,
    )


class Planned(NamedTuple):
    """What the planner hands to the controller."""

    command: Command
    encounters: Array  # (8, 7)
    active_rows: int
    saturated: bool
    violation: float  # [m/s]


@leaf
def _planned(
    state: AgentState,
    inputs: AgentInputs,
    behaviour: Behaviour,
    rates: Array,
    yaw: float,
    dt: float,
    config: AgentConfig,
) -> Planned:
    """Clearance above the behaviour, the speed limit, and the command filter."""
    top = clearance(
        part(inputs.own, 0, 3),
        behaviour.velocity,
        inputs.near,
        inputs.near_age_s,
        state.encounters,
        dt,
        config.clearance,
    )
    limits = config.filter
    velocity = composed(top, behaviour.jacobian, limits.max_speed)
    linear = filter_step(
        part(state.command, 0, 3), velocity.velocity, limits.bandwidth, limits.max_acceleration, dt
    )
    angular = filter_step(
        part(state.command, 3, 3), rates, limits.rate_bandwidth, limits.max_rate_acceleration, dt
    )
    return Planned(
        Command(linear.value, linear.rate, angular.value, angular.rate, yaw),
        top.encounters,
        top.jacobian.shape[0],
        velocity.limited or linear.saturated,
        velocity.violation,
    )


@leaf
def _told(inputs: AgentInputs, planned: Planned, config: AgentConfig) -> Array:
    """Velocity setpoint (4,): [m/s, ENU] and yaw rate [rad/s], for a vehicle that closes its own loops."""
    command = planned.command
    out = np.empty(4)
    put(out, 0, command.velocity)
    out[3] = command.rates[2]
    if config.controller.plant != PLANT_RIGID_BODY:
        off = wrap(command.yaw - yaw_of(inputs.own))
        most = config.filter.max_rate
        out[3] = min(max(config.controller.attitude_gain[1] * off, -most), most)
    return out


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

    errors = state.start_error.copy()
    arms = state.mode == _NOT_YET or t < state.last_t or state.heard != heard
    armed = Armed(arms, part(errors, 0, 3), part(errors, 3, 3))
    behaviour = behaviour_of_mission(inputs, estimate, armed, clock, config)
    rates, euler_error = np.zeros(3), np.zeros(3)
    if config.controller.plant == PLANT_RIGID_BODY:  # a quadrotor's attitude is its controller's
        rates, euler_error = attitude(inputs.own, yaw, armed, clock, config)
    if arms:
        put(errors, 0, behaviour.error)
        put(errors, 3, euler_error)
    if holding:
        behaviour = held(behaviour, inputs, place, config)

    planned = _planned(state, inputs, behaviour, rates, yaw, dt, config)
    command = planned.command
    control = _controlled(state, inputs, command, clock, config)
    stored = np.empty(6)
    put(stored, 0, command.velocity)
    put(stored, 3, command.rates)
    after = AgentState(
        estimate,
        heard,
        stored,
        control.parameters,
        control.bound,
        control.observer,
        planned.encounters,
        errors,
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
    outputs = AgentOutputs(
        _told(inputs, planned, config), control.wrench, estimate_to_odometry(estimate), diagnostics
    )
    return after, outputs
