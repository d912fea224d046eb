"""Plant `quadrotor`: one thrust along body z and three torques through motors with lag and limits.

State (17,): position [m, ENU] 0:3, quaternion x y z w 3:7, velocity [m/s, ENU] 7:10, body rates [rad/s]
10:13, actual thrust [N] 13, actual torques [N m] 14:17. Drag is linear in the air speed, so wind pushes.
"""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_sim.plants.contract import PlantConfig


@inline_kernel
def derivative(x: Array, wrench: Array, push: Array, config: PlantConfig, out: Array) -> None:
    """x_dot into `out` (17,), for commanded thrust wrench[2] and torques wrench[3:6], disturbance (6,)."""
    a, b, c, d = x[3], x[4], x[5], x[6]
    p, q, r = x[10], x[11], x[12]
    for i in range(3):
        out[i] = x[7 + i]
    out[3] = 0.5 * (d * p + b * r - c * q)
    out[4] = 0.5 * (d * q + c * p - a * r)
    out[5] = 0.5 * (d * r + a * q - b * p)
    out[6] = -0.5 * (a * p + b * q + c * r)
    lift = x[13] / config.mass
    drag = config.drag
    out[7] = 2.0 * (a * c + d * b) * lift - drag * (x[7] - config.wind[0]) + push[0]
    out[8] = 2.0 * (b * c - d * a) * lift - drag * (x[8] - config.wind[1]) + push[1]
    up = 1.0 - 2.0 * (a * a + b * b)
    out[9] = up * lift - config.gravity - drag * (x[9] - config.wind[2]) + push[2]
    ix, iy, iz = config.inertia[0], config.inertia[1], config.inertia[2]
    out[10] = (x[14] + (iy - iz) * q * r) / ix + push[3]
    out[11] = (x[15] + (iz - ix) * r * p) / iy + push[4]
    out[12] = (x[16] + (ix - iy) * p * q) / iz + push[5]
    rate = 1.0 / config.motor_lag_s
    out[13] = (min(max(wrench[2], 0.0), config.max_thrust) - x[13]) * rate
    for i in range(3):
        most = config.max_torque[i]
        out[14 + i] = (min(max(wrench[3 + i], -most), most) - x[14 + i]) * rate


@inline_kernel
def normalise(x: Array) -> None:
    """Bring the quaternion of a state (17,) back to unit length, in place."""
    length = math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5] + x[6] * x[6])
    for i in range(3, 7):
        x[i] /= length


@inline_kernel
def odometry(x: Array) -> Array:
    """Odometry vector (13,) of a state (17,): the velocity turned into the body frame."""
    out = np.empty(ODOMETRY_SIZE)
    store(out, 0, x[0:7])
    rotation = rotation_from_quaternion(x[3:7])
    for i in range(3):
        out[7 + i] = rotation[0, i] * x[7] + rotation[1, i] * x[8] + rotation[2, i] * x[9]
    store(out, 10, x[10:13])
    return out
