"""The vehicle's pose in its own local frame, axes ENU and FLU, from its messages; of a simulated one the true pose.

No sockets and no ROS: messages in, states out, all times on our steady clock [s].

A checksum of 16 bits accepts one broken packet in 65536. On an unsigned link a value that contradicts the previous one
is therefore accepted only when the next message confirms it: a vehicle repeats its state, a broken packet is not
repeated. A real change is delayed by one message: 20 ms for a position, one request and its answer for a mode.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.timesync import VehicleClock

TRUTH_MESSAGES = ("HIL_STATE_QUATERNION", "SIM_STATE")
"""The true place of a simulated vehicle, of PX4 and of ArduPilot. Nothing flies by it; a real vehicle sends neither."""

_DEGREES_E7, _CENTI, _MILLI, _MICRO = 1e-7, 1e-2, 1e-3, 1e-6
_ATTITUDE_AGE_S = 0.2
_FARTHEST_M = 1e5
_NORM_TOLERANCE = 0.05
_LOCAL_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD)
# Steps and rates that a quadrotor can have; an estimator may reset by decimetres.
_POSITION = (np.array([0.2] * 3 + [0.5] * 3), np.array([15.0] * 3 + [20.0] * 3))  # [m, m/s]
_ATTITUDE = (np.array([0.1] * 6 + [1.0] * 3), np.array([5.0] * 6 + [40.0] * 3))  # [1, rad/s]


class ConfirmedValue:
    """A value that changes only when two messages agree."""

    def __init__(self) -> None:
        self._known: Hashable | None = None
        self._candidate: Hashable | None = None

    @property
    def unconfirmed(self) -> bool:
        """True if the newest message had a new value that no other message has confirmed yet."""
        return self._candidate is not None

    def accepts(self, value: Hashable) -> bool:
        """True if this message is plausible."""
        known = value in (self._known, self._candidate)
        if known:
            self._known = value
        self._candidate = None if known else value
        return known


class RateLimitedValue:
    """Numbers (n,) that move no faster than a vehicle can."""

    def __init__(self, step: Array, rate: Array) -> None:
        """`step` (n,): largest jump that is plausible at once; `rate` (n,): largest change per second."""
        self._step, self._rate = step, rate
        self._seen: list[tuple[Array, float]] = []  # the last accepted, and the one not confirmed
        self.rejected = 0

    def accepts(self, numbers: Array, now_s: float) -> bool:
        """True if these numbers are plausible; False for NaN."""
        for last, last_s in self._seen:
            most = self._step + self._rate * (now_s - last_s)
            if (np.abs(numbers - last) <= most).all():
                self._seen = [(numbers, now_s)]
                return True
        self.rejected += bool(self._seen)
        self._seen = [*self._seen[:1], (numbers, now_s)]
        return False


class VehicleState(NamedTuple):
    """One state of the vehicle in its own local frame, axes ENU and FLU."""

    boot_s: float  # time since the vehicle's boot
    odometry: Array  # (13,)


class _Attitude(NamedTuple):
    boot_s: float
    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s], FLU


class Pose:
    """The newest attitude and position; `signed`: whether every message can be believed."""

    def __init__(self, *, signed: bool) -> None:
        self.clock = VehicleClock()
        self.position_s: float | None = None  # when the newest position arrived
        self.quaternion_s = float("-inf")  # when the newest ATTITUDE_QUATERNION arrived
        self.invalid = 0
        self._attitude: _Attitude | None = None
        self._uses_odometry = False
        self._plausible_position = None if signed else RateLimitedValue(*_POSITION)
        self._plausible_attitude = None if signed else RateLimitedValue(*_ATTITUDE)

    @property
    def rejected(self) -> int:
        """Implausible messages: each would have counted if the next one had confirmed it."""
        both = (self._plausible_position, self._plausible_attitude)
        return sum(each.rejected for each in both if each is not None)

    @property
    def leaves_odometry(self) -> bool:
        """True once LOCAL_POSITION_NED has come: from then on ODOMETRY says nothing that counts."""
        return self.position_s is not None and not self._uses_odometry

    def on_time(self, message: Any, now_s: float) -> None:
        """SYSTEM_TIME, and what each message of the pose says of the time since boot."""
        if self.clock.update(_boot_time_s(message), now_s):
            self._attitude = None  # its time belongs to another clock

    def on_attitude(self, message: Any, now_s: float) -> None:
        """ATTITUDE or ATTITUDE_QUATERNION."""
        self.on_time(message, now_s)
        if message.get_type() == "ATTITUDE":
            wxyz = frames.quaternion_from_euler_ned(message.roll, message.pitch, message.yaw)
        else:
            self.quaternion_s = now_s
            wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        self._keep_attitude(message, wxyz, now_s)

    def on_position(self, message: Any, now_s: float) -> VehicleState | None:
        """LOCAL_POSITION_NED: a state with the newest attitude."""
        self.on_time(message, now_s)
        self._uses_odometry, self.position_s = False, now_s
        attitude = self._attitude
        if attitude is None or abs(_boot_time_s(message) - attitude.boot_s) > _ATTITUDE_AGE_S:
            return None
        velocity = frames.vector_ned_to_enu(np.array([message.vx, message.vy, message.vz]))
        if not np.isfinite(velocity).all():
            self.invalid += 1
            return None
        body_velocity = rotation_from_quaternion(attitude.quaternion).T @ velocity
        return self._state(message, velocity, body_velocity, now_s)

    def on_odometry(self, message: Any, now_s: float) -> VehicleState | None:
        """ODOMETRY, for controllers that send neither position nor attitude alone."""
        self.on_time(message, now_s)
        local = (message.frame_id, message.child_frame_id) == _LOCAL_FRAMES
        if self.leaves_odometry or not local:
            return None
        self._uses_odometry, self.position_s = True, now_s
        self._keep_attitude(message, np.array(message.q), now_s)
        if self._attitude is None or self._attitude.boot_s != _boot_time_s(message):
            return None
        velocity = frames.vector_frd_to_flu(np.array([message.vx, message.vy, message.vz]))
        return self._state(message, velocity, velocity, now_s)

    def _keep_attitude(self, message: Any, wxyz: Array, now_s: float) -> None:
        quaternion = _quaternion(wxyz)
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        if quaternion is None or not np.isfinite(rates).all():
            self.invalid += 1
            return
        # The rotation is compared, because a quaternion may change its sign and mean the same.
        rotation = rotation_from_quaternion(quaternion)
        numbers = np.concatenate((rotation[:, 0], rotation[:, 2], rates))
        if self._plausible_attitude is None or self._plausible_attitude.accepts(numbers, now_s):
            body_rates = frames.vector_frd_to_flu(rates)
            self._attitude = _Attitude(_boot_time_s(message), quaternion, body_rates)

    def _state(
        self, message: Any, velocity: Array, body_velocity: Array, now_s: float
    ) -> VehicleState | None:
        """The state, if its position and its velocity as sent follow those before."""
        attitude, plausible = self._attitude, self._plausible_position
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        numbers = np.concatenate((position, velocity))
        if attitude is None or (plausible is not None and not plausible.accepts(numbers, now_s)):
            return None
        odometry = np.concatenate((position, attitude.quaternion, body_velocity, attitude.rates))
        if not np.isfinite(odometry).all() or np.abs(position).max() > _FARTHEST_M:
            self.invalid += 1
            return None
        return VehicleState(_boot_time_s(message), odometry)


def _boot_time_s(message: Any) -> float:
    if message.get_type() == "ODOMETRY":
        return float(message.time_usec * _MICRO)
    return float(message.time_boot_ms * _MILLI)


def _quaternion(wxyz: Array) -> Array | None:
    """Attitude (4,) x y z w, FLU to ENU, of one w x y z, FRD to NED; None for numbers that are no attitude."""
    norm = float(np.sqrt(wxyz @ wxyz))
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        return None
    return frames.quaternion_ned_frd_to_enu_flu(wxyz / norm)


def place_of(message: Any) -> GeoPoint:
    """The true place on the Earth of a simulated vehicle."""
    if message.get_type() == "HIL_STATE_QUATERNION":
        return GeoPoint(message.lat * _DEGREES_E7, message.lon * _DEGREES_E7, message.alt * _MILLI)
    if message.lat_int or message.lon_int:  # `lat` and `lon` are floats: good to a metre
        return GeoPoint(message.lat_int * _DEGREES_E7, message.lon_int * _DEGREES_E7, message.alt)
    return GeoPoint(message.lat, message.lon, message.alt)


def true_odometry(message: Any, position: Array) -> Array | None:
    """Odometry (13,) at a world position (3,) [m] with attitude and velocities of the message; None if not finite."""
    if message.get_type() == "HIL_STATE_QUATERNION":
        wxyz = np.array(message.attitude_quaternion, dtype=np.float64)
        rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
        velocity = _CENTI * np.array([message.vx, message.vy, message.vz])
    else:
        wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        rates = (message.xgyro, message.ygyro, message.zgyro)
        velocity = np.array([message.vn, message.ve, message.vd])
    quaternion = _quaternion(wxyz)
    if quaternion is None:
        return None
    out = np.empty(ODOMETRY_SIZE)
    out[0:3], out[3:7] = position, quaternion
    out[7:10] = rotation_from_quaternion(quaternion).T @ frames.vector_ned_to_enu(velocity)
    out[10:13] = frames.vector_frd_to_flu(np.array(rates))
    return out if np.isfinite(out).all() else None
