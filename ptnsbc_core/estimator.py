"""Leader estimator (43)-(48), equations.md section 5: position, velocity and yaw of the leader.

The factor 1/lambda_min(H) makes the networked error reach the residual at tf2 whatever the graph is. The
saturation (47) alone leaves an error in proportion to the leader's speed; the estimated velocity as
feed-forward removes it.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import put, saturation, wrap
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.kinematics import odometry_to_estimate, state_to_estimate
from ptnsbc_core.timebase import Clock, step_gain
from ptnsbc_core.types import (
    NEVER_HEARD_S,
    AgentConfig,
    AgentInputs,
    AgentState,
    Array,
    EstimatorConfig,
)

_YAW = 6


@kernel
def disagreement(
    estimate: Array, estimates: Array, heard: Array, leader: Array, pinned: bool
) -> Array:
    """g_i (7,) = sum_j a_ij (X_i - X_j) + b_i (X_i - X_1), (46); yaw differences are wrapped.

    Args:
        estimate: (7,) own estimate.
        estimates: (K, 7) neighbours' estimates, `heard` (K,) 1 where there is one.
        leader: (7,) the leader's state, used when `pinned`.
        pinned: whether the leader's state is at hand.
    """
    g = np.zeros(7)
    for k in range(estimates.shape[0]):
        if heard[k] > 0.0:
            for i in range(_YAW):
                g[i] += estimate[i] - estimates[k, i]
            g[_YAW] += wrap(estimate[_YAW] - estimates[k, _YAW])
    if pinned:
        for i in range(_YAW):
            g[i] += estimate[i] - leader[i]
        g[_YAW] += wrap(estimate[_YAW] - leader[_YAW])
    return g


@kernel
def estimator_step(
    estimate: Array, g: Array, t: float, dt: float, config: EstimatorConfig
) -> Array:
    """One step of (44), (7,): X_dot = -Xi_2 g - k_1 g - k_2 sat(g / width), plus v_hat for the position."""
    gain = step_gain(t, dt, config.duration_s, config.residual) / config.lambda_min + config.k1
    out = np.empty(7)
    for i in range(7):
        rate = -gain * g[i] - config.k2 * saturation(g[i], config.boundary)
        if config.feed_forward and i < 3:
            rate += estimate[3 + i]
        out[i] = estimate[i] + dt * rate
    out[_YAW] = wrap(out[_YAW])
    return out


@leaf
def _moved_on(estimate: Array, age_s: float) -> Array:
    """Estimate (7,) of `age_s` ago carried to the present with its own velocity."""
    out = estimate.copy()
    for i in range(3):
        out[i] += age_s * estimate[3 + i]
    return out


@leaf
def estimated_leader(
    state: AgentState, inputs: AgentInputs, clock: Clock, frozen: bool, config: AgentConfig
) -> tuple[Array, bool]:
    """Leader estimate (7,) at this tick, and whether it rests on anything heard."""
    if config.leader:
        return state_to_estimate(inputs.own), True
    pinned = config.estimator.pinned and inputs.leader_age_s < NEVER_HEARD_S
    leader = np.zeros(7)
    if pinned:
        leader = _moved_on(state_to_estimate(inputs.leader), inputs.leader_age_s)
        if not state.heard:
            return leader, True
    if frozen:
        still = state.estimate.copy()
        for i in range(3, 6):
            still[i] = 0.0
        return still, state.heard
    count = inputs.estimates.shape[0]
    others = np.empty((count, 7))
    heard = np.zeros(count)
    anything = pinned
    for k in range(count):
        if inputs.estimate_age_s[k] <= config.stale_s:
            age_s = inputs.estimate_age_s[k]
            put(others[k], 0, _moved_on(odometry_to_estimate(inputs.estimates[k]), age_s))
            heard[k] = 1.0
            anything = True
    if not anything:
        return state.estimate.copy(), state.heard
    # everything heard is carried to the present, so the own estimate must be too: compared one tick late
    # it settles v dt behind, which the angle tasks multiply along the chain
    present = state.estimate
    if config.estimator.feed_forward:
        present = _moved_on(state.estimate, clock.dt)
    g = disagreement(present, others, heard, leader, pinned)
    return estimator_step(state.estimate, g, clock.t, clock.dt, config.estimator), True
