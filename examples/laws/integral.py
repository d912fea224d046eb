"""A law of one's own with a memory: a UAV beside its first neighbour, which learns what keeps it from its place."""

import numpy as np

GAIN_1_S, INTEGRAL_1_S2 = 1.5, 0.5


def integral(inputs):
    """Velocity [m/s, ENU], and for the next tick the time [s] and the integral of the error [m s]."""
    now = inputs.positions[0] + inputs.ages_s[0] * inputs.velocities[0]
    error = now - inputs.offsets[0] + inputs.offset - inputs.position
    learnt = inputs.memory[1:] + (inputs.t - inputs.memory[0]) * error
    beside = inputs.offset_velocity - inputs.offset_velocities[0]
    velocity = inputs.velocities[0] + beside + GAIN_1_S * error + INTEGRAL_1_S2 * learnt
    return velocity, np.array([inputs.t, learnt[0], learnt[1], learnt[2]])


integral.memory = (0.0, 0.0, 0.0, 0.0)  # at every epoch
