"""The leader's desired trajectory: a parameter vector, so that every process computes the same curve.

Layout (12,): circle [0, cx, cy, cz, radius, rate, phase, yaw, ...] with x = cx + r sin(rate t + phase),
y = cy + r cos(rate t + phase), as the paper writes it; line [1, px, py, pz, vx, vy, vz, yaw, ...].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import part
from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import TRAJECTORY_CIRCLE, Array


class Reference(NamedTuple):
    """Desired state of the leader at one time, world ENU."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) [m/s]
    yaw: float  # [rad]


@kernel
def reference(trajectory: Array, t: float) -> Reference:
    """Desired state at t [s] since the first epoch."""
    position = part(trajectory, 1, 3)
    velocity = np.zeros(3)
    if int(trajectory[0]) == TRAJECTORY_CIRCLE:
        radius, rate = trajectory[4], trajectory[5]
        angle = rate * t + trajectory[6]
        position[0] += radius * math.sin(angle)
        position[1] += radius * math.cos(angle)
        velocity[0] = radius * rate * math.cos(angle)
        velocity[1] = -radius * rate * math.sin(angle)
        return Reference(position, velocity, trajectory[7])
    for i in range(3):
        velocity[i] = trajectory[4 + i]
        position[i] += velocity[i] * t
    return Reference(position, velocity, trajectory[7])
