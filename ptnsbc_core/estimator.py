"""Leader estimator (43)-(48), equations.md section 5: position, velocity and yaw of the leader.

The factor 1/lambda_min(H) makes the networked error reach the residual at tf2 whatever the graph is. The
saturation (47) alone leaves an error in proportion to the leader's speed; the estimated velocity as
feed-forward removes it.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import minus, moved, plus, saturation, wrap
from ptnsbc_core.kernel import leaf
from ptnsbc_core.kinematics import odometry_to_estimate, state_to_estimate
from ptnsbc_core.timebase import Clock, step_gain
from ptnsbc_core.types import (
    NEVER_HEARD_S,
    AgentConfig,
    AgentInputs,
    AgentState,
    Estimate,
    EstimatorConfig,
    Vector3,
)

NONE = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
"""No disagreement."""


class EstimatorMeasurements(NamedTuple):
    """What was heard at this tick, compared with the own estimate."""

    disagreement: Estimate  # g_i
    anything: bool


@leaf
def disagreeing(g: Estimate, estimate: Estimate, other: Estimate) -> Estimate:
    """One more term of g_i = sum_j a_ij (X_i - X_j) + b_i (X_i - X_1), (46); yaw differences are wrapped."""
    return Estimate(
        plus(g.position, minus(estimate.position, other.position)),
        plus(g.velocity, minus(estimate.velocity, other.velocity)),
        g.yaw + wrap(estimate.yaw - other.yaw),
    )


@leaf
def _stepped(value: float, g: float, gain: float, dt: float, config: EstimatorConfig) -> float:
    rate = -gain * g - config.k2 * saturation(g, config.boundary)
    return value + dt * rate


@leaf
def _stepped3(
    value: Vector3, g: Vector3, forward: Vector3, gain: float, dt: float, config: EstimatorConfig
) -> Vector3:
    k2, width = config.k2, config.boundary
    return (
        value[0] + dt * (-gain * g[0] - k2 * saturation(g[0], width) + forward[0]),
        value[1] + dt * (-gain * g[1] - k2 * saturation(g[1], width) + forward[1]),
        value[2] + dt * (-gain * g[2] - k2 * saturation(g[2], width) + forward[2]),
    )


@leaf
def estimator_step(
    estimate: Estimate, g: Estimate, t: float, dt: float, config: EstimatorConfig
) -> Estimate:
    """One step of (44): X_dot = -Xi_2 g - k_1 g - k_2 sat(g / width), plus v_hat for the position."""
    gain = step_gain(t, dt, config.duration_s, config.residual) / config.lambda_min + config.k1
    forward = estimate.velocity if config.feed_forward else (0.0, 0.0, 0.0)
    return Estimate(
        _stepped3(estimate.position, g.position, forward, gain, dt, config),
        _stepped3(estimate.velocity, g.velocity, (0.0, 0.0, 0.0), gain, dt, config),
        wrap(_stepped(estimate.yaw, g.yaw, gain, dt, config)),
    )


@leaf
def _moved_on(estimate: Estimate, age_s: float) -> Estimate:
    """Estimate of `age_s` ago carried to the present with its own velocity."""
    velocity = estimate.velocity
    return Estimate(moved(estimate.position, age_s, velocity), velocity, estimate.yaw)


@leaf
def _heard(
    present: Estimate, inputs: AgentInputs, pinned: bool, config: AgentConfig
) -> EstimatorMeasurements:
    """Neighbours' estimates and the leader's state, carried to the present, against the own estimate."""
    g, anything = NONE, pinned
    for k in range(inputs.estimates.shape[0]):
        age_s = inputs.estimate_age_s[k]
        if age_s <= config.stale_s:
            other = _moved_on(odometry_to_estimate(inputs.estimates[k]), age_s)
            g, anything = disagreeing(g, present, other), True
    if pinned:
        leader = _moved_on(state_to_estimate(inputs.leader), inputs.leader_age_s)
        g = disagreeing(g, present, leader)
    return EstimatorMeasurements(g, anything)


@leaf
def estimated_leader(
    state: AgentState, inputs: AgentInputs, clock: Clock, frozen: bool, config: AgentConfig
) -> tuple[Estimate, bool]:
    """Leader estimate at this tick, and whether it rests on anything heard."""
    if config.leader:
        return state_to_estimate(inputs.own), True
    pinned = config.estimator.pinned and inputs.leader_age_s < NEVER_HEARD_S
    if pinned and not state.heard:
        return _moved_on(state_to_estimate(inputs.leader), inputs.leader_age_s), True
    if frozen:
        last = state.estimate
        return Estimate(last.position, (0.0, 0.0, 0.0), last.yaw), state.heard
    # everything heard is carried to the present, so the own estimate must be too: compared one tick late
    # it settles v dt behind, which the angle tasks multiply along the chain
    present = state.estimate
    if config.estimator.feed_forward:
        present = _moved_on(state.estimate, clock.dt)
    heard = _heard(present, inputs, pinned, config)
    if not heard.anything:
        return state.estimate, state.heard
    step = estimator_step(state.estimate, heard.disagreement, clock.t, clock.dt, config.estimator)
    return step, True
