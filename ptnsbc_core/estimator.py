"""Leader estimator (43)-(48), docs/method.md: position, velocity and yaw X of the leader, as a follower i has them.

    g_i = sum_j a_ij (X_i - X_j) + b_i (X_i - X_1)                               (46)
    X_dot_i = -(Xi_2 / lambda_min(H) + k_1) g_i - k_2 sat(g_i / width)           (44), + v_hat_i for the position

The factor 1/lambda_min(H) makes the networked error reach the residual at tf2 for every graph. The saturation
(47) alone leaves an error in proportion to the leader's speed; the estimated velocity as feed-forward removes it.
"""

from __future__ import annotations

from ptnsbc_core.algebra import add3, axpy, saturation, sub3, wrap_angle
from ptnsbc_core.behaviours.neighbour import extrapolated
from ptnsbc_core.kernel import formula, inline_kernel
from ptnsbc_core.kinematics import is_estimate, odometry_to_estimate, state_to_estimate, yaw_of
from ptnsbc_core.timebase import Clock, step_gain
from ptnsbc_core.types import (
    MODE_FORMATION,
    NEVER_RECEIVED_S,
    AgentConfig,
    AgentInputs,
    AgentState,
    Estimate,
    EstimatorConfig,
    NeighbourMotion,
    Vector3,
)

NO_DISAGREEMENT = Estimate((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
"""g before its first term."""


@inline_kernel
def add_disagreement(g: Estimate, estimate: Estimate, other: Estimate) -> Estimate:
    """One more term of g_i = sum_j a_ij (X_i - X_j) + b_i (X_i - X_1), (46); yaw differences are wrapped."""
    return Estimate(
        add3(g.position, sub3(estimate.position, other.position)),
        add3(g.velocity, sub3(estimate.velocity, other.velocity)),
        g.yaw + wrap_angle(estimate.yaw - other.yaw),
    )


@inline_kernel
def _euler_step3(
    value: Vector3, g: Vector3, forward: Vector3, gain: float, dt: float, config: EstimatorConfig
) -> Vector3:
    k2, width = config.k2, config.boundary
    return (
        value[0] + dt * (-gain * g[0] - k2 * saturation(g[0], width) + forward[0]),
        value[1] + dt * (-gain * g[1] - k2 * saturation(g[1], width) + forward[1]),
        value[2] + dt * (-gain * g[2] - k2 * saturation(g[2], width) + forward[2]),
    )


@inline_kernel
def estimator_step(
    estimate: Estimate, g: Estimate, t: float, dt: float, config: EstimatorConfig
) -> Estimate:
    """One step of (44): X_dot = -Xi_2 g - k_1 g - k_2 sat(g / width), plus v_hat for the position."""
    gain = step_gain(t, dt, config.duration_s, config.residual) / config.lambda_min + config.k1
    yaw_rate = -gain * g.yaw - config.k2 * saturation(g.yaw, config.boundary)
    forward = estimate.velocity if config.feed_forward else (0.0, 0.0, 0.0)
    return Estimate(
        _euler_step3(estimate.position, g.position, forward, gain, dt, config),
        _euler_step3(estimate.velocity, g.velocity, (0.0, 0.0, 0.0), gain, dt, config),
        wrap_angle(estimate.yaw + dt * yaw_rate),
    )


@formula
def _extrapolate(estimate: Estimate, age_s: float, acceleration: Vector3) -> Estimate:
    """Estimate of `age_s` ago, extrapolated to the present by its velocity and the leader's acceleration."""
    position = axpy(age_s, estimate.velocity, estimate.position)
    return Estimate(
        axpy(0.5 * age_s * age_s, acceleration, position),
        axpy(age_s, acceleration, estimate.velocity),
        estimate.yaw,
    )


@inline_kernel
def _received_leader(
    inputs: AgentInputs, motion: NeighbourMotion, dt: float, slot: Vector3
) -> Estimate:
    """The leader's own message, extrapolated to the present, less the slot (3,) [m] of the leader."""
    leader = extrapolated(inputs.leader, motion, inputs.leader_age_s, dt)
    return Estimate(sub3(leader.position, slot), leader.velocity, yaw_of(inputs.leader))


@inline_kernel
def _measurements(
    present: Estimate,
    inputs: AgentInputs,
    pinned: bool,
    motion: NeighbourMotion,
    dt: float,
    config: AgentConfig,
) -> tuple[Estimate, int]:
    """Disagreement of the own estimate with the neighbours' estimates and the leader's state, and how many they are."""
    g, terms = NO_DISAGREEMENT, 0
    for k in range(inputs.estimates.shape[0]):
        age_s = inputs.estimate_age_s[k]
        if age_s <= config.stale_s and is_estimate(inputs.estimates[k]):
            other = odometry_to_estimate(inputs.estimates[k])
            other = _extrapolate(other, age_s, motion.acceleration)
            g, terms = add_disagreement(g, present, other), terms + 1
    if pinned:
        leader = _received_leader(inputs, motion, dt, config.leader_slot)
        g, terms = add_disagreement(g, present, leader), terms + 1
    return g, terms


@formula
def _at_rest(estimate: Estimate) -> Estimate:
    return Estimate(estimate.position, (0.0, 0.0, 0.0), estimate.yaw)


@inline_kernel
def leader_estimate(
    state: AgentState,
    inputs: AgentInputs,
    motion: NeighbourMotion,
    clock: Clock,
    lost: bool,
    config: AgentConfig,
) -> tuple[Estimate, bool]:
    """Leader estimate at this tick, and whether it has been initialised from a message.

    What is estimated is the reference point of the formation: the leader's position less its slot, which is zero until
    another UAV takes over.
    `motion` is the leader's, of its own messages; without a leader link its acceleration is zero. The estimate stays
    where it is while a link is `lost`. In a leg that holds, and before the first leg is known, it is what is received:
    the leader may fly on meanwhile. Where nothing is received in flight, it goes on with its velocity.
    """
    if config.leader:
        own = state_to_estimate(inputs.own)
        return Estimate(sub3(own.position, config.leader_slot), own.velocity, own.yaw), True
    pinned = config.estimator.pinned and inputs.leader_age_s < NEVER_RECEIVED_S
    if pinned and not state.estimate_valid:
        return _received_leader(inputs, motion, clock.dt, config.leader_slot), True
    if lost:
        return _at_rest(state.estimate), state.estimate_valid
    waits = inputs.mode != MODE_FORMATION
    if waits and pinned and inputs.leader_age_s <= config.stale_s:
        return _received_leader(inputs, motion, clock.dt, config.leader_slot), True
    # Received states are extrapolated to the present, so the own estimate must be too. Compared one tick late, it
    # settles v dt behind, and the angle tasks multiply that error along the chain.
    before, present = state.estimate, state.estimate
    if config.estimator.feed_forward:
        present = _extrapolate(state.estimate, clock.dt, motion.acceleration)
        # The step below adds velocity * dt: of the velocity now, so half a step's change comes off.
        back = axpy(-0.5 * clock.dt * clock.dt, motion.acceleration, state.estimate.position)
        before = Estimate(back, present.velocity, present.yaw)
    g, terms = _measurements(present, inputs, pinned, motion, clock.dt, config)
    if terms == 0:
        goes_on = state.estimate_valid and not waits
        return present if goes_on else _at_rest(state.estimate), state.estimate_valid
    if waits or not state.estimate_valid:
        share = 1.0 / terms  # g is the sum of the differences from what was received
        position = axpy(-share, g.position, present.position)
        velocity = axpy(-share, g.velocity, present.velocity)
        return Estimate(position, velocity, wrap_angle(present.yaw - share * g.yaw)), True
    return estimator_step(before, g, clock.t, clock.dt, config.estimator), True
