"""Noise of the near-object sensor, and the error of the own position in what it measures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array

SAMPLES = 6
"""Random numbers per object: noise of its position and of its velocity."""


class SensorNoise(NamedTuple):
    """Standard deviations of the near-object sensor, per axis."""

    noise_m: float
    velocity_noise_m_s: float


@kernel
def add_sensor_noise(
    near: Array, truth: Array, measured: Array, samples: Array, kind: SensorNoise
) -> Array:
    """Near objects (M, 7) as a UAV measures them.

    The sensor measures relative position and velocity. Converted to the world frame they contain the errors of
    the UAV's own position and velocity. Rounded to float32 like all data of the sensor.

    Args:
        near: (M, 7) the true near objects.
        truth: (13,) the UAV's true odometry vector.
        measured: (13,) its measured odometry vector.
        samples: (6 M,) standard normal numbers, or more.
        kind: the sensor.
    """
    out = near.copy()
    true_velocity, measured_velocity = velocity_enu(truth), velocity_enu(measured)
    for row in range(out.shape[0]):
        for i in range(3):
            noise = kind.noise_m * samples[6 * row + i]
            out[row, i] = np.float32(out[row, i] + (measured[i] - truth[i]) + noise)
            noise = kind.velocity_noise_m_s * samples[6 * row + 3 + i]
            velocity = out[row, 4 + i] + (measured_velocity[i] - true_velocity[i]) + noise
            out[row, 4 + i] = np.float32(velocity)
    return out
