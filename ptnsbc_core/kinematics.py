"""Kinematics (1)-(6) with a corrected rotation matrix, and the accessors of an odometry vector."""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.algebra import axpy, load3, matvec, matvec_transposed, norm3, scale3, store3
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.types import Array, Estimate, Matrix3, OdometryLike, Vector3, Vector3Like


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


@formula
def rotation(q: OdometryLike, at: int) -> Matrix3:
    """Rows of R, body to world, from the unit quaternion x y z w that begins at entry `at`."""
    x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


@inline_kernel
def rotation_from_quaternion(q: Array) -> Array:
    """R (3, 3), body to world, from a unit quaternion x y z w."""
    r = np.empty((3, 3))
    rows = rotation(q, 0)
    store3(r[0], 0, rows[0])
    store3(r[1], 0, rows[1])
    store3(r[2], 0, rows[2])
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
def euler_from_rotation(r: Array | Matrix3) -> Vector3:
    """(roll, pitch, yaw) [rad] of R (3, 3); pitch in [-pi/2, pi/2]."""
    return (
        math.atan2(r[2][1], r[2][2]),
        math.asin(min(max(-r[2][0], -1.0), 1.0)),
        math.atan2(r[1][0], r[0][0]),
    )


@formula
def euler_rates(euler: Vector3Like, rates: Vector3Like) -> Vector3:
    """(3), (4): Euler angle rates [rad/s] = W(euler) body rates. Infinite at cos(pitch) = 0."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    ct, tt = math.cos(euler[1]), math.tan(euler[1])
    return (
        rates[0] + sf * tt * rates[1] + cf * tt * rates[2],
        cf * rates[1] - sf * rates[2],
        (sf * rates[1] + cf * rates[2]) / ct,
    )


@formula
def body_rates(euler: Vector3Like, rates: Vector3Like) -> Vector3:
    """Body rates [rad/s] = W^-1(euler) Euler rates; regular everywhere."""
    sf, cf = math.sin(euler[0]), math.cos(euler[0])
    st, ct = math.sin(euler[1]), math.cos(euler[1])
    return (
        rates[0] - st * rates[2],
        cf * rates[1] + sf * ct * rates[2],
        -sf * rates[1] + cf * ct * rates[2],
    )


@formula
def velocity_enu(odometry: OdometryLike) -> Vector3:
    """World velocity [m/s] of an odometry vector whose twist is in the body frame."""
    return matvec(rotation(odometry, 3), load3(odometry, 7))


@kernel
def move_to_present(odometry: Array, age_s: float) -> None:
    """Move the pose of an odometry vector (13,) by its twist over its age: where the vehicle is by now.

    World velocity and body rates stay as they were measured.
    """
    velocity, rates = velocity_enu(odometry), load3(odometry, 10)
    store3(odometry, 0, axpy(age_s, velocity, load3(odometry, 0)))
    x, y, z, w = odometry[3], odometry[4], odometry[5], odometry[6]
    half = 0.5 * age_s * norm3(rates)
    sine, c = (math.sin(half) / half if half > 0.0 else 1.0), math.cos(half)
    a, b, d = scale3(0.5 * age_s * sine, rates)
    odometry[3] = c * x + w * a + y * d - z * b
    odometry[4] = c * y + w * b + z * a - x * d
    odometry[5] = c * z + w * d + x * b - y * a
    odometry[6] = c * w - x * a - y * b - z * d
    store3(odometry, 7, matvec_transposed(rotation(odometry, 3), velocity))


@formula
def yaw_of(odometry: OdometryLike) -> float:
    """Yaw [rad] of an odometry vector."""
    x, y, z, w = odometry[3], odometry[4], odometry[5], odometry[6]
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@inline_kernel
def store_estimate(out: Array, estimate: Estimate, known: bool) -> None:
    """Write a leader estimate into `out` (13,), as an odometry vector with the twist in the world frame.

    An estimate has a heading only. The half turn about x says that its sender knows nothing of the leader yet.
    """
    store3(out, 0, estimate.position)
    out[3] = 0.0 if known else 1.0
    out[4] = 0.0
    out[5] = math.sin(0.5 * estimate.yaw) if known else 0.0
    out[6] = math.cos(0.5 * estimate.yaw) if known else 0.0
    store3(out, 7, estimate.velocity)
    store3(out, 10, (0.0, 0.0, 0.0))


@formula
def odometry_to_estimate(odometry: OdometryLike) -> Estimate:
    """The leader estimate of an odometry vector with the twist in the world frame."""
    return Estimate(load3(odometry, 0), load3(odometry, 7), yaw_of(odometry))


@inline_kernel
def is_estimate(odometry: OdometryLike) -> bool:
    """True if a leader estimate (13,) was made by somebody who knows of the leader."""
    return bool(odometry[5] != 0.0 or odometry[6] != 0.0)


@formula
def state_to_estimate(odometry: OdometryLike) -> Estimate:
    """Position, velocity and yaw of a UAV's own odometry vector (twist in the body frame)."""
    return Estimate(load3(odometry, 0), velocity_enu(odometry), yaw_of(odometry))
