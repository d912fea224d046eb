"""A law of one's own: the velocity nearest to consensus that control barrier functions allow (CBF-QP).

minimize |v - wanted|^2 subject to n_k (v - v_k) >= -ALPHA h_k for every object near, h_k its distance beyond the
keep-out. SciPy's `nnls` solves this quadratic program exactly, as least-distance programming of Lawson and Hanson.
"""

import numpy as np
from scipy.optimize import nnls

GAIN_1_S, SOFT_S, ALPHA_1_S = 2.0, 1.0, 2.0


def cbf_qp(inputs):
    """Velocity [m/s, ENU]."""
    gain = GAIN_1_S * min(inputs.t / SOFT_S, 1.0)
    now = inputs.positions + inputs.ages_s[:, None] * inputs.velocities
    closing = now - inputs.offsets - (inputs.position - inputs.offset)
    wanted = np.mean(inputs.velocities + gain * closing, axis=0)
    away = inputs.position - inputs.near[:, :3]
    distance = np.linalg.norm(away, axis=1)
    normals = away / distance[:, None]
    least = np.sum(normals * inputs.near[:, 4:7], axis=1)
    least -= ALPHA_1_S * (distance - inputs.near[:, 3])
    return wanted + nearest(normals, least - normals @ wanted)


def nearest(normals, least):
    """The shortest x with normals x >= least; zero where nothing binds or nothing satisfies it."""
    if not np.any(least > 0.0):
        return np.zeros(3)
    weights, _ = nnls(np.vstack([normals.T, least]), np.array([0.0, 0.0, 0.0, 1.0]))
    x, y, z, rest = np.vstack([normals.T, least]) @ weights - [0.0, 0.0, 0.0, 1.0]
    return -np.array([x, y, z]) / rest if abs(rest) > 1e-9 else np.zeros(3)
