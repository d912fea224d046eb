"""Kinematics (1)-(6) with the rotation matrix that is one, and the accessors of an odometry vector."""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.algebra import put
from ptnsbc_core.errors import AttitudeError
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.types import ODOMETRY_SIZE, Array

SINGULAR_COSINE = 1e-6
"""|cos(pitch)| below which Euler rates are refused."""


@kernel
def rotation_from_euler(euler: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), body FLU to world ENU, from (roll, pitch, yaw) [rad]: (2) corrected."""
    cf, sf = math.cos(euler[0]), math.sin(euler[0])
    ct, st = math.cos(euler[1]), math.sin(euler[1])
    cp, sp = math.cos(euler[2]), math.sin(euler[2])
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = cp * ct, cp * st * sf - sp * cf, cp * st * cf + sp * sf
    r[1, 0], r[1, 1], r[1, 2] = sp * ct, sp * st * sf + cp * cf, sp * st * cf - cp * sf
    r[2, 0], r[2, 1], r[2, 2] = -st, ct * sf, ct * cf
    return r


@leaf
def rotation_from_quaternion(q: Array) -> Array:
    """R (3, 3), body to world, from a unit quaternion x y z w."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return r


@kernel
def quaternion_from_euler(euler: Array) -> Array:
    """Unit quaternion x y z w from (roll, pitch, yaw) [rad]."""
    cf, sf = math.cos(0.5 * euler[0]), math.sin(0.5 * euler[0])
    ct, st = math.cos(0.5 * euler[1]), math.sin(0.5 * euler[1])
    cp, sp = math.cos(0.5 * euler[2]), math.sin(0.5 * euler[2])
    q = np.empty(4)
    q[0] = sf * ct * cp - cf * st * sp
    q[1] = cf * st * cp + sf * ct * sp
    q[2] = cf * ct * sp - sf * st * cp
    q[3] = cf * ct * cp + sf * st * sp
    return q


@kernel
def euler_from_rotation(r: Array) -> Array:
    """(roll, pitch, yaw) [rad] of R (3, 3); pitch in [-pi/2, pi/2]."""
    euler = np.empty(3)
    euler[0] = math.atan2(r[2, 1], r[2, 2])
    euler[1] = math.asin(min(max(-r[2, 0], -1.0), 1.0))
    euler[2] = math.atan2(r[1, 0], r[0, 0])
    return euler


@kernel
def euler_rates(euler: Array, rates: Array) -> Array:
    """(3), (4): Euler angle rates [rad/s] = W(euler) body rates. Infinite at cos(pitch) = 0, see `checked_pitch`."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    ct, tt = math.cos(euler[1]), math.tan(euler[1])
    out = np.empty(3)
    out[0] = rates[0] + sf * tt * rates[1] + cf * tt * rates[2]
    out[1] = cf * rates[1] - sf * rates[2]
    out[2] = (sf * rates[1] + cf * rates[2]) / ct
    return out


@kernel
def body_rates(euler: Array, rates: Array) -> Array:
    """Body rates [rad/s] = W^-1(euler) Euler rates; regular everywhere."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    st, ct = math.sin(euler[1]), math.cos(euler[1])
    out = np.empty(3)
    out[0] = rates[0] - st * rates[2]
    out[1] = cf * rates[1] + sf * ct * rates[2]
    out[2] = -sf * rates[1] + cf * ct * rates[2]
    return out


def checked_pitch(pitch_rad: float) -> float:
    """The pitch, if W is finite there.

    Raises:
        AttitudeError: cos(pitch) is zero for all practical purposes.
    """
    if abs(math.cos(pitch_rad)) < SINGULAR_COSINE:
        raise AttitudeError(
            f"pitch={pitch_rad:.6f} rad: Euler rates are singular at +-pi/2; "
            "start below it or use the plant 'quadrotor', which integrates a quaternion"
        )
    return pitch_rad


@leaf
def velocity_enu(odometry: Array) -> Array:
    """World velocity (3,) [m/s] of an odometry vector whose twist is in the body frame."""
    r = rotation_from_quaternion(odometry[3:7])
    out = np.empty(3)
    for i in range(3):
        out[i] = r[i, 0] * odometry[7] + r[i, 1] * odometry[8] + r[i, 2] * odometry[9]
    return out


@leaf
def yaw_of(odometry: Array) -> float:
    """Yaw [rad] of an odometry vector."""
    x, y, z, w = odometry[3], odometry[4], odometry[5], odometry[6]
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@kernel
def estimate_to_odometry(estimate: Array) -> Array:
    """Leader estimate (7,) p v yaw to an odometry vector (13,) with the twist in the world frame."""
    out = np.zeros(ODOMETRY_SIZE)
    put(out, 0, estimate[0:3])
    out[5] = math.sin(0.5 * estimate[6])
    out[6] = math.cos(0.5 * estimate[6])
    put(out, 7, estimate[3:6])
    return out


@kernel
def odometry_to_estimate(odometry: Array) -> Array:
    """Inverse of `estimate_to_odometry`, (7,)."""
    out = np.empty(7)
    put(out, 0, odometry[0:3])
    put(out, 3, odometry[7:10])
    out[6] = yaw_of(odometry)
    return out


@kernel
def state_to_estimate(odometry: Array) -> Array:
    """(7,) p v yaw of a UAV's own odometry vector (twist in the body frame)."""
    out = np.empty(7)
    put(out, 0, odometry[0:3])
    put(out, 3, velocity_enu(odometry))
    out[6] = yaw_of(odometry)
    return out
