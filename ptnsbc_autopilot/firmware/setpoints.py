"""SET_POSITION_TARGET_LOCAL_NED and SET_ATTITUDE_TARGET as targets of the airframe."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_autopilot.physics import airframe
from ptnsbc_autopilot.physics.frames import (
    Quaternion,
    attitude_swap,
    body_swap,
    rotate_heading,
    world_swap,
    yaw_swap,
)
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

_YAW_BIT, _YAW_RATE_BIT = 10, 11  # of POSITION_TARGET_TYPEMASK; 0 to 8 are x y z vx vy vz ax ay az


class PositionTarget(NamedTuple):
    """A position target in its own frame; NaN where a field is ignored."""

    frame: int
    position_ned: Array  # (3,) [m]
    velocity_ned: Array  # (3,) [m/s]
    acceleration_ned: Array  # (3,) [m/s^2]
    yaw_ned_rad: float
    yaw_rate_ned_rad_s: float
    force: bool


class AttitudeSetpoint(NamedTuple):
    """An attitude target; NaN where a field is ignored, None without attitude."""

    attitude_ned: Quaternion | None
    rates_frd: Array  # (3,) [rad/s]
    thrust: float


def _fields(mask: int, first_bit: int, values: tuple[float, ...]) -> Array:
    """The values, NaN where the mask has their bit to ignore them."""
    return np.array([math.nan if mask >> first_bit + i & 1 else v for i, v in enumerate(values)])


def read_position_target(message: Any) -> PositionTarget:
    """The fields of a SET_POSITION_TARGET_LOCAL_NED that its type mask does not ignore."""
    m, mask = message, message.type_mask
    return PositionTarget(
        m.coordinate_frame,
        _fields(mask, 0, (m.x, m.y, m.z)),
        _fields(mask, 3, (m.vx, m.vy, m.vz)),
        _fields(mask, 6, (m.afx, m.afy, m.afz)),
        math.nan if mask >> _YAW_BIT & 1 else m.yaw,
        math.nan if mask >> _YAW_RATE_BIT & 1 else m.yaw_rate,
        bool(mask & mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET),
    )


def heading_to_ned(wanted: PositionTarget, heading_ned_rad: float) -> PositionTarget:
    """The same with velocity and acceleration turned from a heading-aligned frame to NED."""
    return wanted._replace(
        velocity_ned=rotate_heading(wanted.velocity_ned, heading_ned_rad),
        acceleration_ned=rotate_heading(wanted.acceleration_ned, heading_ned_rad),
    )


def position_airframe_target(wanted: PositionTarget) -> Array:
    """A target (22,) of the airframe for a trajectory in local NED."""
    target = airframe.no_target()
    target[airframe.KIND] = airframe.TRAJECTORY
    target[airframe.POSITION] = world_swap(wanted.position_ned)
    target[airframe.VELOCITY] = world_swap(wanted.velocity_ned)
    target[airframe.ACCELERATION] = world_swap(wanted.acceleration_ned)
    if math.isfinite(wanted.yaw_ned_rad):
        target[airframe.YAW] = yaw_swap(wanted.yaw_ned_rad)
    target[airframe.YAW_RATE] = -wanted.yaw_rate_ned_rad_s
    return target


def read_attitude(message: Any) -> AttitudeSetpoint:
    """The fields of a SET_ATTITUDE_TARGET that its type mask does not ignore."""
    mask = message.type_mask
    rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    ignored = mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
    no_thrust = mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
    return AttitudeSetpoint(
        None if ignored else Quaternion(*(float(v) for v in message.q)),
        _fields(mask, 0, rates),
        math.nan if no_thrust else message.thrust,
    )


def is_unit(q: Quaternion, tolerance: float) -> bool:
    """True if the length of a quaternion is one within a tolerance; False for NaN."""
    return abs(math.sqrt(sum(v * v for v in q)) - 1.0) <= tolerance


def down_in_body(q: Quaternion) -> Array:
    """The vertical (3,), down, in FRD."""
    w, x, y, z = q
    return np.array((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))


def attitude_airframe_target(wanted: AttitudeSetpoint) -> Array:
    """A target (22,) of the airframe; ignored rates are zero where there is no attitude."""
    target = airframe.no_target()
    rates = body_swap(wanted.rates_frd)
    target[airframe.THRUST] = min(max(wanted.thrust, 0.0), 1.0)
    if wanted.attitude_ned is None:
        target[airframe.KIND] = airframe.RATES
        target[airframe.BODY_RATES] = np.nan_to_num(rates)
        return target
    target[airframe.KIND] = airframe.ATTITUDE
    length = math.sqrt(sum(v * v for v in wanted.attitude_ned))
    q = attitude_swap(Quaternion(*(v / length for v in wanted.attitude_ned)))
    target[airframe.QUATERNION] = (q.x, q.y, q.z, q.w)
    target[airframe.BODY_RATES] = rates
    return target
