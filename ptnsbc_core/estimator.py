"""Leader estimator (43)-(48), equations.md section 5: position, velocity and yaw of the leader.

The factor 1/lambda_min(H) makes the networked error reach the residual at tf2 whatever the graph is. The
saturation (47) alone leaves an error in proportion to the leader's speed; the estimated velocity as
feed-forward removes it.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import saturation, wrap
from ptnsbc_core.kernel import kernel
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import Array, EstimatorConfig

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
