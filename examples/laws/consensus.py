"""A law of one's own: consensus. Each neighbour says where the leader would be by its own place; agree on that."""

import numpy as np

GAIN_1_S = 2.0
SOFT_S = 1.0  # the gain grows during this time: the vehicles need not jump


def consensus(inputs):
    """Velocity [m/s]: that of the neighbours, and the way to where they see the formation."""
    gain = GAIN_1_S * min(inputs.t / SOFT_S, 1.0)
    own_origin = inputs.position - inputs.offset
    velocity = np.zeros(3)
    for k in range(len(inputs.ids)):
        now = inputs.positions[k] + inputs.ages_s[k] * inputs.velocities[k]
        velocity += inputs.velocities[k] + gain * (now - inputs.offsets[k] - own_origin)
    return velocity / len(inputs.ids)
