"""ArduCopter's GUIDED mode: submodes, shaped velocities, timeouts. Sources: docs/autopilot.md.

A velocity moves a position target, which the vehicle follows: unlike PX4, zero velocity holds the place by the
estimate (mode_guided.cpp, `stabilizing_pos_xy`).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.firmware import setpoints
from ptnsbc_sim.autopilot.physics import airframe, targets
from ptnsbc_sim.autopilot.physics.frames import moved_on, rotate_heading, world_swap, yaw_swap

_LEASH_M = 1.5
_MOST_STEP_S = 0.1
_UNIT_TOLERANCE = 1e-3
_SANE = 1000.0
_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
_BODY = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)
FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY)


class Submode(Enum):
    """What GUIDED follows."""

    TAKE_OFF = 0
    VELOCITY = 1
    POSITION = 2
    ANGLE = 3


class WaypointLimits(NamedTuple):
    """From WP_*."""

    speed: float  # [m/s]
    up: float  # [m/s]
    down: float  # [m/s]
    acceleration: float  # [m/s^2]


class EstimatedState(NamedTuple):
    """Estimate of now, ENU."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) [m/s]
    heading_ned_rad: float


class Guided:
    """State of the mode; made anew each time it is entered."""

    def __init__(self, seen: EstimatedState, t: float) -> None:
        self.submode = Submode.VELOCITY
        self.place = seen.position.copy()  # position target, ENU
        self.yaw: float | None = yaw_swap(seen.heading_ned_rad)
        self.yaw_rate = math.nan
        self._wanted = np.zeros(3)  # velocity asked for
        self._shaped = np.zeros(3)  # velocity within the acceleration
        self._acceleration = np.zeros(3)
        self._attitude = targets.IDLE_TARGET
        self._thrust_is_climb = False
        self._climb = 0.0
        self._latest_t = self._stepped_t = t
        self.take_off_height = 0.0

    # What arrives.

    def take_off(self, seen: EstimatedState, height_m: float) -> None:
        """Climb over this place."""
        self.submode, self.take_off_height = Submode.TAKE_OFF, height_m
        self.place = seen.position.copy()

    def trajectory(self, message: Any, seen: EstimatedState, t: float) -> bool:
        """A SET_POSITION_TARGET_LOCAL_NED, partly ignored vectors ignored whole; False when not valid."""
        wanted = setpoints.trajectory(message)
        position = wanted.position_ned if np.isfinite(wanted.position_ned).all() else None
        velocity = None if message.type_mask & _VELOCITY else wanted.velocity_ned
        if wanted.frame not in FRAMES or (wanted.force and wanted.accelerations):
            return False
        if velocity is not None and not (np.abs(velocity) <= _SANE).all():
            return False
        if position is None and velocity is None:
            return False
        self._turn(wanted, seen)
        if position is not None:
            self._go(position, velocity, wanted.frame, seen)
        else:
            self._move(velocity, wanted.frame, seen)
        self._latest_t = t
        return True

    def _go(
        self, position: Array, velocity: Array | None, frame: int, seen: EstimatedState
    ) -> None:
        if frame in _BODY:
            position = rotate_heading(position, seen.heading_ned_rad)
        self.place = world_swap(position)
        if frame != mavlink.MAV_FRAME_LOCAL_NED:
            self.place = self.place + seen.position
        if velocity is None:
            self.submode, self._wanted = Submode.POSITION, np.zeros(3)
        else:
            self.submode, self._wanted = Submode.VELOCITY, self._in_enu(velocity, frame, seen)
            self._shaped = self._wanted

    def _move(self, velocity: Array | None, frame: int, seen: EstimatedState) -> None:
        if self.submode is not Submode.VELOCITY:
            self.place, self._shaped = seen.position.copy(), seen.velocity.copy()
        self.submode = Submode.VELOCITY
        if velocity is not None:
            self._wanted = self._in_enu(velocity, frame, seen)

    @staticmethod
    def _in_enu(velocity: Array, frame: int, seen: EstimatedState) -> Array:
        if frame in _BODY:
            velocity = rotate_heading(velocity, seen.heading_ned_rad)
        return world_swap(velocity)

    def _turn(self, wanted: setpoints.Trajectory, seen: EstimatedState) -> None:
        self.yaw_rate = -wanted.yaw_rate_ned_rad_s
        if math.isfinite(wanted.yaw_ned_rad):
            relative = seen.heading_ned_rad if wanted.frame in _BODY else 0.0
            self.yaw = yaw_swap(wanted.yaw_ned_rad + relative)
        elif math.isfinite(self.yaw_rate):
            self.yaw = None

    def attitude(
        self, message: Any, limits: WaypointLimits, thrust_is_thrust: bool, t: float
    ) -> bool:
        """A SET_ATTITUDE_TARGET; False when not valid.

        Its thrust is a climb rate about 0.5 unless GUID_OPTIONS says otherwise.
        """
        wanted = setpoints.attitude(message)
        rates = np.isfinite(wanted.rates_frd)
        bad = wanted.attitude_ned is not None and not setpoints.unit(
            wanted.attitude_ned, _UNIT_TOLERANCE
        )
        if not math.isfinite(wanted.thrust) or bad or rates.any() != rates.all():
            return False
        self.submode, self._latest_t = Submode.ANGLE, t
        self._thrust_is_climb = not thrust_is_thrust
        self._attitude = setpoints.attitude_target(wanted)
        share = 2.0 * min(max(wanted.thrust, 0.0), 1.0) - 1.0
        self._climb = share * (limits.up if share > 0.0 else limits.down)
        return True

    @property
    def lifts(self) -> bool:
        """Whether an attitude target asks to leave the ground."""
        if self.submode is not Submode.ANGLE:
            return False
        return self._climb > 0.0 or not self._thrust_is_climb

    # What is followed.

    def aim(
        self, seen: EstimatedState, limits: WaypointLimits, timeout_s: float, t: float
    ) -> Array:
        """Target (22,) at t [s]; without setpoints for `timeout_s` it stops, and stays in the mode."""
        dt = min(t - self._stepped_t, _MOST_STEP_S)
        self._stepped_t = t
        silent = t - self._latest_t > timeout_s
        if self.submode is Submode.ANGLE:
            self._advance(dt)
            return self._angle(seen, silent)
        if silent:
            self.yaw_rate = math.nan
            if self.submode is Submode.VELOCITY:
                self._wanted = np.zeros(3)
        if self.submode is Submode.TAKE_OFF:
            left = self.take_off_height - float(seen.position[2])
            climb = min(left, limits.up)
            return targets.climb(
                targets.TargetPoint(self.place, yaw_swap(seen.heading_ned_rad)), climb
            )
        if self.submode is Submode.VELOCITY:
            self._shape(limits, dt)
            self._lead(seen, dt)
        return self._target()

    def _shape(self, limits: WaypointLimits, dt: float) -> None:
        """Velocity towards the wanted one, within speed and acceleration."""
        goal = self._wanted.copy()
        speed = math.hypot(goal[0], goal[1])
        if speed > limits.speed:
            goal[0:2] *= limits.speed / speed
        goal[2] = min(max(goal[2], -limits.down), limits.up)
        step = goal - self._shaped
        length, most = float(np.linalg.norm(step)), limits.acceleration * dt
        before = self._shaped
        self._shaped = goal if length <= most else before + step * (most / length)
        self._acceleration = (self._shaped - before) / dt if dt > 0.0 else np.zeros(3)

    def _lead(self, seen: EstimatedState, dt: float) -> None:
        """Move the position target on, no further ahead than the leash."""
        self.place = self.place + self._shaped * dt
        off = self.place - seen.position
        length = float(np.linalg.norm(off))
        if length > _LEASH_M:
            self.place = seen.position + off * (_LEASH_M / length)

    def _target(self) -> Array:
        target = airframe.no_target()
        target[airframe.KIND] = airframe.TRAJECTORY
        target[airframe.POSITION] = self.place
        target[airframe.VELOCITY] = 0.0
        if self.submode is Submode.VELOCITY:
            target[airframe.VELOCITY] = self._shaped
            target[airframe.ACCELERATION] = self._acceleration
        if self.yaw is not None:
            target[airframe.YAW] = self.yaw
        target[airframe.YAW_RATE] = self.yaw_rate
        return target

    def _advance(self, dt: float) -> None:
        """Turn the attitude on with the rates beside it until the next target comes, or the timeout."""
        rates = self._attitude[airframe.BODY_RATES]
        if self._attitude[airframe.KIND] == airframe.ATTITUDE and np.isfinite(rates).all():
            self._attitude[airframe.QUATERNION] = moved_on(
                self._attitude[airframe.QUATERNION], rates, dt
            )

    def _angle(self, seen: EstimatedState, silent: bool) -> Array:
        if silent:
            level = targets.sink(0.0)
            level[airframe.YAW] = yaw_swap(seen.heading_ned_rad)
            return level
        if not self._thrust_is_climb:
            return self._attitude
        target = self._attitude.copy()
        target[airframe.CLIMB] = self._climb
        return target
