"""The leader's desired trajectory: a parameter vector from which every process computes the same curve.

Layout (8,): circle [0, cx, cy, cz, radius, rate, phase, yaw] with x = cx + r sin(rate t + phase),
y = cy + r cos(rate t + phase), as the paper writes it; line [1, px, py, pz, vx, vy, vz, yaw].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, store3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import TRAJECTORY_CIRCLE, Array, Vector3


class Reference(NamedTuple):
    """Desired state of the leader at one time, world ENU."""

    position: Vector3  # [m]
    velocity: Vector3  # [m/s]
    yaw: float  # [rad]
    acceleration: Vector3  # [m/s^2]


@kernel
def reference(trajectory: tuple[float, ...], t: float) -> Reference:
    """Desired state at t [s] since the first epoch."""
    x, y, z = trajectory[1], trajectory[2], trajectory[3]
    if int(trajectory[0]) == TRAJECTORY_CIRCLE:
        radius, rate = trajectory[4], trajectory[5]
        angle = rate * t + trajectory[6]
        sine, cosine = math.sin(angle), math.cos(angle)
        along = (radius * rate * cosine, -radius * rate * sine, 0.0)
        inward = -radius * rate * rate
        return Reference(
            (x + radius * sine, y + radius * cosine, z),
            along,
            trajectory[7],
            (inward * sine, inward * cosine, 0.0),
        )
    along = (trajectory[4], trajectory[5], trajectory[6])
    return Reference(axpy(t, along, (x, y, z)), along, trajectory[7], (0.0, 0.0, 0.0))


@kernel
def reference_positions(trajectory: tuple[float, ...], times: Array) -> Array:
    """Desired positions (T, 3) [m] at times (T,) [s] since the first epoch."""
    out = np.empty((times.shape[0], 3))
    for k in range(times.shape[0]):
        store3(out[k], 0, reference(trajectory, times[k]).position)
    return out
