"""What a UAV makes of the objects near it: a sensor measures from the vehicle, and it believes itself elsewhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array

DRAWS = 6
"""Random numbers per object: noise of its position and of its velocity."""


class SensorNoise(NamedTuple):
    """How well the sensor sees, per axis."""

    noise_m: float
    velocity_noise_m_s: float


@kernel
def beside(near: Array, truth: Array, seen: Array, draws: Array, kind: SensorNoise) -> Array:
    """Near objects (M, 7) as a UAV places them.

    What the sensor measures is where something is from here and how it moves against this vehicle; the
    errors of the own position and velocity are in what is told of it in the world's axes. Rounded to
    float32 like everything that the sensor tells.

    Args:
        near: (M, 7) where they really are.
        truth: (13,) its true odometry vector.
        seen: (13,) what it believes of itself.
        draws: (6 M,) standard normal numbers or more.
        kind: the sensor.
    """
    out = near.copy()
    true_velocity, seen_velocity = velocity_enu(truth), velocity_enu(seen)
    for row in range(out.shape[0]):
        for i in range(3):
            off = kind.noise_m * draws[6 * row + i]
            out[row, i] = np.float32(out[row, i] + (seen[i] - truth[i]) + off)
            off = kind.velocity_noise_m_s * draws[6 * row + 3 + i]
            moving = out[row, 4 + i] + (seen_velocity[i] - true_velocity[i]) + off
            out[row, 4 + i] = np.float32(moving)
    return out
