"""ArduCopter's GUIDED mode: submodes, shaped velocities, timeouts. Sources: docs/autopilot.md.

A velocity moves a position target, which the vehicle follows: unlike PX4, zero velocity holds the place by the
estimate (mode_guided.cpp, `stabilizing_pos_xy`).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_autopilot.firmware import setpoints
from ptnsbc_autopilot.physics import airframe, targets
from ptnsbc_autopilot.physics.frames import integrate_rates, rotate_heading, world_swap, yaw_swap
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

_LEASH_M = 1.5
_MOST_STEP_S = 0.1
_UNIT_TOLERANCE = 1e-3
_LARGEST_M_S = 1000.0
_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
_BODY = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)
FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY)


class Submode(Enum):
    """The kind of target that GUIDED follows."""

    TAKE_OFF = 0
    VELOCITY = 1
    POSITION = 2
    ANGLE = 3


class WaypointLimits(NamedTuple):
    """Limits of GUIDED, from WP_* and PSC_JERK_*."""

    speed: float  # [m/s]
    up: float  # [m/s]
    down: float  # [m/s]
    acceleration: float  # [m/s^2] horizontal
    climb_acceleration: float  # [m/s^2]
    jerk: float  # [m/s^3] horizontal
    climb_jerk: float  # [m/s^3]


class EstimatedState(NamedTuple):
    """The present estimate, ENU."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) [m/s]
    heading_ned_rad: float


def _within(vector: Array, most: float) -> Array:
    """A vector shortened to a length."""
    length = math.sqrt(float(vector @ vector))
    return vector if length <= most else vector * (most / length)


class Guided:
    """State of the mode, new each time the mode is entered."""

    def __init__(self, state: EstimatedState, t: float) -> None:
        self.submode = Submode.VELOCITY
        self._position = state.position.copy()  # position target, ENU
        self.yaw: float | None = yaw_swap(state.heading_ned_rad)
        self.yaw_rate = math.nan
        self._requested = np.zeros(3)  # requested velocity
        self._requested_acceleration = np.zeros(3)
        self._shaped = np.zeros(3)  # velocity within acceleration and jerk
        self._acceleration = np.zeros(3)  # of the shaped velocity
        self._attitude = targets.IDLE_TARGET
        self._thrust_is_climb = False
        self._climb = 0.0
        self._latest_t = t
        self._stepped_t = t
        self.take_off_height = 0.0

    # Requests.

    def take_off(self, state: EstimatedState, height_m: float) -> None:
        """Climb over the present position."""
        self.submode, self.take_off_height = Submode.TAKE_OFF, height_m
        self._position = state.position.copy()

    def take_position_target(self, message: Any, state: EstimatedState, t: float) -> bool:
        """Take a SET_POSITION_TARGET_LOCAL_NED; False when it is not valid.

        A vector that is ignored in part is ignored whole.
        """
        wanted = setpoints.read_position_target(message)
        position = wanted.position_ned if np.isfinite(wanted.position_ned).all() else None
        velocity = None if message.type_mask & _VELOCITY else wanted.velocity_ned
        acceleration = wanted.acceleration_ned
        if velocity is None or not np.isfinite(acceleration).all():
            acceleration = np.zeros(3)
        if wanted.frame not in FRAMES or (
            wanted.force and np.isfinite(wanted.acceleration_ned).any()
        ):
            return False
        if velocity is not None and not (np.abs(velocity) <= _LARGEST_M_S).all():
            return False
        if position is None and velocity is None:
            return False
        self._set_yaw(wanted, state)
        self._requested_acceleration = self._in_enu(acceleration, wanted.frame, state)
        if position is not None:
            self._follow_position(position, velocity, wanted.frame, state)
        else:
            self._follow_velocity(velocity, wanted.frame, state)
        self._latest_t = t
        return True

    def _follow_position(
        self, position: Array, velocity: Array | None, frame: int, state: EstimatedState
    ) -> None:
        if frame in _BODY:
            position = rotate_heading(position, state.heading_ned_rad)
        self._position = world_swap(position)
        if frame != mavlink.MAV_FRAME_LOCAL_NED:
            self._position = self._position + state.position
        if velocity is None:
            self.submode, self._requested = Submode.POSITION, np.zeros(3)
        else:
            self.submode, self._requested = Submode.VELOCITY, self._in_enu(velocity, frame, state)
            self._shaped = self._requested

    def _follow_velocity(self, velocity: Array | None, frame: int, state: EstimatedState) -> None:
        if self.submode is not Submode.VELOCITY:
            self._position, self._shaped = state.position.copy(), state.velocity.copy()
            self._acceleration = np.zeros(3)
        self.submode = Submode.VELOCITY
        if velocity is not None:
            self._requested = self._in_enu(velocity, frame, state)

    @staticmethod
    def _in_enu(velocity: Array, frame: int, state: EstimatedState) -> Array:
        if frame in _BODY:
            velocity = rotate_heading(velocity, state.heading_ned_rad)
        return world_swap(velocity)

    def _set_yaw(self, wanted: setpoints.PositionTarget, state: EstimatedState) -> None:
        self.yaw_rate = -wanted.yaw_rate_ned_rad_s
        if math.isfinite(wanted.yaw_ned_rad):
            relative = state.heading_ned_rad if wanted.frame in _BODY else 0.0
            self.yaw = yaw_swap(wanted.yaw_ned_rad + relative)
        elif math.isfinite(self.yaw_rate):
            self.yaw = None

    def take_attitude_target(
        self, message: Any, limits: WaypointLimits, thrust_is_thrust: bool, t: float
    ) -> bool:
        """Take a SET_ATTITUDE_TARGET; False when it is not valid.

        Its thrust is a climb rate about 0.5, unless GUID_OPTIONS makes it a thrust.
        """
        wanted = setpoints.read_attitude(message)
        rates = np.isfinite(wanted.rates_frd)
        bad = wanted.attitude_ned is not None and not setpoints.is_unit(
            wanted.attitude_ned, _UNIT_TOLERANCE
        )
        if not math.isfinite(wanted.thrust) or bad or rates.any() != rates.all():
            return False
        self.submode, self._latest_t = Submode.ANGLE, t
        self._thrust_is_climb = not thrust_is_thrust
        self._attitude = setpoints.attitude_airframe_target(wanted)
        share = 2.0 * min(max(wanted.thrust, 0.0), 1.0) - 1.0
        self._climb = share * (limits.up if share > 0.0 else limits.down)
        return True

    @property
    def climbs(self) -> bool:
        """True if an attitude target leads off the ground."""
        if self.submode is not Submode.ANGLE:
            return False
        return self._climb > 0.0 or not self._thrust_is_climb

    # The target of the airframe.

    def airframe_target(
        self, state: EstimatedState, limits: WaypointLimits, timeout_s: float, t: float
    ) -> Array:
        """Target (22,) at t [s]; without setpoints for `timeout_s` it stops and stays in the mode."""
        dt = min(t - self._stepped_t, _MOST_STEP_S)
        self._stepped_t = t
        timed_out = t - self._latest_t > timeout_s
        if self.submode is Submode.ANGLE:
            self._advance_attitude(dt)
            return self._attitude_target(state, timed_out)
        if timed_out:
            self.yaw_rate = math.nan
            if self.submode is Submode.VELOCITY:
                self._requested, self._requested_acceleration = np.zeros(3), np.zeros(3)
        if self.submode is Submode.TAKE_OFF:
            left = self.take_off_height - float(state.position[2])
            climb = min(left, limits.up)
            return targets.climb(
                targets.TargetPoint(self._position, yaw_swap(state.heading_ned_rad)), climb
            )
        if self.submode is Submode.VELOCITY:
            self._shape_velocity(limits, dt)
            self._advance_position(state, dt)
        return self._position_target()

    def _shape_velocity(self, limits: WaypointLimits, dt: float) -> None:
        """Move the velocity to the requested one, within speed, acceleration and jerk.

        The acceleration follows `k (requested - shaped)` with k = jerk / acceleration, plus the requested one:
        a first order of k for small steps (`shape_vel_accel` of AP_Math/control.cpp). The requested velocity itself
        goes on with its acceleration until the next setpoint (`update_vel_accel_xy`).
        """
        self._requested = self._requested + dt * self._requested_acceleration
        goal = self._requested.copy()
        speed = math.hypot(goal[0], goal[1])
        if speed > limits.speed:
            goal[0:2] *= limits.speed / speed
        goal[2] = min(max(goal[2], -limits.down), limits.up)
        error, ahead, now = goal - self._shaped, self._requested_acceleration, self._acceleration
        level = limits.jerk / limits.acceleration * error[0:2]
        level = _within(level, limits.acceleration) + ahead[0:2]
        climb, most = (
            limits.climb_jerk / limits.climb_acceleration * error[2:],
            limits.climb_acceleration,
        )
        climb = _within(climb, most) + ahead[2:]
        steps = (
            _within(level - now[0:2], limits.jerk * dt),
            _within(climb - now[2:], limits.climb_jerk * dt),
        )
        self._acceleration = now + np.concatenate(steps)
        self._shaped = self._shaped + self._acceleration * dt

    def _advance_position(self, state: EstimatedState, dt: float) -> None:
        """Move the position target with the velocity, at most the leash ahead of the vehicle."""
        self._position = self._position + self._shaped * dt
        off = self._position - state.position
        length = float(np.linalg.norm(off))
        if length > _LEASH_M:
            self._position = state.position + off * (_LEASH_M / length)

    def _position_target(self) -> Array:
        target = airframe.no_target()
        target[airframe.KIND] = airframe.TRAJECTORY
        target[airframe.POSITION] = self._position
        target[airframe.VELOCITY] = 0.0
        if self.submode is Submode.VELOCITY:
            target[airframe.VELOCITY] = self._shaped
            target[airframe.ACCELERATION] = self._acceleration
        if self.yaw is not None:
            target[airframe.YAW] = self.yaw
        target[airframe.YAW_RATE] = self.yaw_rate
        return target

    def _advance_attitude(self, dt: float) -> None:
        """Turn the attitude target with its body rates until the next target, or the timeout."""
        rates = self._attitude[airframe.BODY_RATES]
        if self._attitude[airframe.KIND] == airframe.ATTITUDE and np.isfinite(rates).all():
            self._attitude[airframe.QUATERNION] = integrate_rates(
                self._attitude[airframe.QUATERNION], rates, dt
            )

    def _attitude_target(self, state: EstimatedState, timed_out: bool) -> Array:
        if timed_out:
            level = targets.sink(0.0)
            level[airframe.YAW] = yaw_swap(state.heading_ned_rad)
            return level
        if not self._thrust_is_climb:
            return self._attitude
        target = self._attitude.copy()
        target[airframe.CLIMB] = self._climb
        return target
