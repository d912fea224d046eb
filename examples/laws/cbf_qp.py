"""A law of one's own: the velocity nearest to consensus that control barrier functions allow (CBF-QP).

minimize |v - wanted|^2 subject to n_k (v - v_k) >= -ALPHA h_k for every object near, h_k its distance beyond the
keep-out. The quadratic program is solved by the method of Hildreth: one constraint after the other, over and over.
"""

import numpy as np

GAIN_1_S, SOFT_S, ALPHA_1_S, ROUNDS, CLOSE_M_S = 2.0, 1.0, 2.0, 50, 1e-9


def cbf_qp(inputs):
    """Velocity [m/s, ENU]."""
    gain = GAIN_1_S * min(inputs.t / SOFT_S, 1.0)
    velocity, own_origin = np.zeros(3), inputs.position - inputs.offset
    for k in range(len(inputs.ids)):
        now = inputs.positions[k] + inputs.ages_s[k] * inputs.velocities[k]
        velocity += inputs.velocities[k] + gain * (now - inputs.offsets[k] - own_origin)
    away = inputs.position - inputs.near[:, :3]
    distance = np.sqrt(np.sum(away * away, axis=1))
    normals = away / distance.reshape(-1, 1)
    least = np.sum(normals * inputs.near[:, 4:7], axis=1)
    least -= ALPHA_1_S * (distance - inputs.near[:, 3])
    return nearest(velocity / len(inputs.ids), normals, least)


def nearest(wanted, normals, least):
    """The velocity nearest to `wanted` with normals v >= least."""
    velocity, forces = wanted.copy(), np.zeros(len(least))
    for _ in range(ROUNDS):
        largest = 0.0
        for k in range(len(least)):
            force = max(0.0, forces[k] + least[k] - np.sum(normals[k] * velocity))
            velocity += (force - forces[k]) * normals[k]
            largest = max(largest, abs(force - forces[k]))
            forces[k] = force
        if largest < CLOSE_M_S:
            break
    return velocity
