"""SET_POSITION_TARGET_LOCAL_NED and SET_ATTITUDE_TARGET as targets of the airframe."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.physics import airframe
from ptnsbc_sim.autopilot.physics.frames import (
    Quaternion,
    attitude_swap,
    body_swap,
    rotate_heading,
    world_swap,
    yaw_swap,
)

_POSITION = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE,
)
_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE,
)
_ACCELERATION = (
    mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE,
    mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE,
)
_BODY_RATES = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE,
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE,
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE,
)


class Trajectory(NamedTuple):
    """A position target in its own frame; NaN where a field is ignored."""

    frame: int
    position_ned: Array  # (3,) [m]
    velocity_ned: Array  # (3,) [m/s]
    acceleration_ned: Array  # (3,) [m/s^2]
    yaw_ned_rad: float
    yaw_rate_ned_rad_s: float
    force: bool

    @property
    def positions(self) -> bool:
        """Whether any axis has a position."""
        return bool(np.isfinite(self.position_ned).any())

    @property
    def velocities(self) -> bool:
        """Whether any axis has a velocity."""
        return bool(np.isfinite(self.velocity_ned).any())

    @property
    def accelerations(self) -> bool:
        """Whether any axis has an acceleration."""
        return bool(np.isfinite(self.acceleration_ned).any())

    @property
    def climbs(self) -> bool:
        """Whether the velocity or the acceleration points up."""
        return bool(self.velocity_ned[2] < 0.0 or self.acceleration_ned[2] < 0.0)


class AttitudeSetpoint(NamedTuple):
    """An attitude target; NaN where a field is ignored, None without attitude."""

    attitude_ned: Quaternion | None
    rates_frd: Array  # (3,) [rad/s]
    thrust: float


def _fields(mask: int, ignored: tuple[int, ...], values: tuple[float, ...]) -> Array:
    return np.array([math.nan if mask & bit else v for bit, v in zip(ignored, values, strict=True)])


def trajectory(message: Any) -> Trajectory:
    """What a SET_POSITION_TARGET_LOCAL_NED says, by its type mask."""
    m, mask = message, message.type_mask
    no_yaw = mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    no_rate = mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
    return Trajectory(
        m.coordinate_frame,
        _fields(mask, _POSITION, (m.x, m.y, m.z)),
        _fields(mask, _VELOCITY, (m.vx, m.vy, m.vz)),
        _fields(mask, _ACCELERATION, (m.afx, m.afy, m.afz)),
        math.nan if no_yaw else m.yaw,
        math.nan if no_rate else m.yaw_rate,
        bool(mask & mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET),
    )


def turned(wanted: Trajectory, heading_ned_rad: float) -> Trajectory:
    """Velocity and acceleration of a heading-aligned frame in NED."""
    return wanted._replace(
        velocity_ned=rotate_heading(wanted.velocity_ned, heading_ned_rad),
        acceleration_ned=rotate_heading(wanted.acceleration_ned, heading_ned_rad),
    )


def trajectory_target(wanted: Trajectory) -> Array:
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


def attitude(message: Any) -> AttitudeSetpoint:
    """What a SET_ATTITUDE_TARGET says, by its type mask."""
    mask = message.type_mask
    rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    ignored = mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
    no_thrust = mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
    return AttitudeSetpoint(
        None if ignored else Quaternion(*(float(v) for v in message.q)),
        _fields(mask, _BODY_RATES, rates),
        math.nan if no_thrust else message.thrust,
    )


def unit(q: Quaternion, tolerance: float) -> bool:
    """Whether the length of a quaternion is one within a tolerance; never for NaN."""
    return abs(math.sqrt(sum(v * v for v in q)) - 1.0) <= tolerance


def down_in_body(q: Quaternion) -> Array:
    """The vertical (3,), down, in FRD."""
    w, x, y, z = q
    return np.array((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))


def attitude_target(wanted: AttitudeSetpoint) -> Array:
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
