"""A law of one's own: an artificial potential field. The place attracts, whatever is near repels."""

import numpy as np

ATTRACT_1_S = 1.0
REPEL_M2_S = 0.4
REACH_M = 1.0  # beyond the keep-out, within which an object repels


def potential_field(inputs):
    """Velocity [m/s]: to the place beside the first neighbour heard, away from objects and UAVs near."""
    now = inputs.positions[0] + inputs.ages_s[0] * inputs.velocities[0]
    place = now - inputs.offsets[0] + inputs.offset
    velocity = inputs.velocities[0] + ATTRACT_1_S * (place - inputs.position)
    for k in range(len(inputs.near)):
        away = inputs.position - inputs.near[k, :3]
        distance = np.sqrt(np.sum(away * away))
        room = max(distance - inputs.near[k, 3], 0.05)
        if room < REACH_M:
            velocity += REPEL_M2_S * (1.0 / room - 1.0 / REACH_M) / room * away / distance
    speed = np.sqrt(np.sum(velocity * velocity))
    return velocity * min(1.0, inputs.max_speed_m_s / max(speed, 1e-9))
