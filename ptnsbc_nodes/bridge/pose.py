"""The vehicle's pose from its MAVLink messages: in its own local frame, axes ENU and FLU.

No sockets and no ROS: messages in, states out, all times on our steady clock [s].
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.plausibility import RateLimitedValue

_MILLI, _MICRO = 1e-3, 1e-6
_ATTITUDE_AGE_S = 0.2
_FARTHEST_M = 1e5
_NORM_TOLERANCE = 0.05
_LOCAL_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD)
# Steps and rates that a quadrotor can have; an estimator may reset by decimetres.
_POSITION = (np.array([0.2] * 3 + [0.5] * 3), np.array([15.0] * 3 + [20.0] * 3))  # [m, m/s]
_ATTITUDE = (np.array([0.1] * 6 + [1.0] * 3), np.array([5.0] * 6 + [40.0] * 3))  # [1, rad/s]


class VehicleState(NamedTuple):
    """One state of the vehicle in its own local frame, axes ENU and FLU."""

    boot_s: float  # time since the vehicle's boot
    odometry: Array  # (13,)


class _Attitude(NamedTuple):
    boot_s: float
    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s], FLU


def boot_time_s(message: Any) -> float:
    """Time since the vehicle's boot that a pose message carries."""
    if message.get_type() == "ODOMETRY":
        return float(message.time_usec * _MICRO)
    return float(message.time_boot_ms * _MILLI)


class Pose:
    """The newest attitude and position; `signed`: whether every message can be believed."""

    def __init__(self, *, signed: bool) -> None:
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

    def forget_attitude(self) -> None:
        """Drop the attitude: its time belongs to another clock now."""
        self._attitude = None

    def on_attitude(self, message: Any, now_s: float) -> None:
        """ATTITUDE or ATTITUDE_QUATERNION."""
        if message.get_type() == "ATTITUDE":
            wxyz = frames.quaternion_from_euler_ned(message.roll, message.pitch, message.yaw)
        else:
            self.quaternion_s = now_s
            wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        self._keep_attitude(message, wxyz, now_s)

    def _keep_attitude(self, message: Any, wxyz: Array, now_s: float) -> None:
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        norm = float(np.sqrt(wxyz @ wxyz))
        if not abs(norm - 1.0) <= _NORM_TOLERANCE or not np.isfinite(rates).all():
            self.invalid += 1
            return
        quaternion = frames.quaternion_ned_frd_to_enu_flu(wxyz / norm)
        # The rotation is compared, because a quaternion may change its sign and mean the same.
        rotation = rotation_from_quaternion(quaternion)
        numbers = np.concatenate((rotation[:, 0], rotation[:, 2], rates))
        if self._plausible_attitude is None or self._plausible_attitude.accepts(numbers, now_s):
            body_rates = frames.vector_frd_to_flu(rates)
            self._attitude = _Attitude(boot_time_s(message), quaternion, body_rates)

    def on_position(self, message: Any, now_s: float) -> VehicleState | None:
        """LOCAL_POSITION_NED: a state with the newest attitude."""
        self._uses_odometry, self.position_s = False, now_s
        attitude, boot_s = self._attitude, boot_time_s(message)
        velocity = frames.vector_ned_to_enu(np.array([message.vx, message.vy, message.vz]))
        if attitude is None or abs(boot_s - attitude.boot_s) > _ATTITUDE_AGE_S:
            return None
        if not np.isfinite(velocity).all():
            self.invalid += 1
            return None
        rotation = rotation_from_quaternion(attitude.quaternion)
        return self._state(message, attitude, velocity, rotation.T @ velocity, now_s)

    def on_odometry(self, message: Any, now_s: float) -> VehicleState | None:
        """ODOMETRY, for controllers that send neither position nor attitude alone."""
        if self.leaves_odometry:
            return None
        if (message.frame_id, message.child_frame_id) != _LOCAL_FRAMES:
            return None
        self._uses_odometry, self.position_s = True, now_s
        self._keep_attitude(message, np.array(message.q), now_s)
        if self._attitude is None or self._attitude.boot_s != boot_time_s(message):
            return None
        velocity = frames.vector_frd_to_flu(np.array([message.vx, message.vy, message.vz]))
        return self._state(message, self._attitude, velocity, velocity, now_s)

    def _state(
        self, message: Any, attitude: _Attitude, velocity: Array, velocity_flu: Array, now_s: float
    ) -> VehicleState | None:
        """The state, if its position and its velocity as sent follow those before."""
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        plausible = self._plausible_position
        if plausible is not None and not plausible.accepts(
            np.concatenate((position, velocity)), now_s
        ):
            return None
        odometry = np.empty(ODOMETRY_SIZE)
        odometry[0:3] = position
        odometry[3:7] = attitude.quaternion
        odometry[7:10] = velocity_flu
        odometry[10:13] = attitude.rates
        if not np.isfinite(odometry).all() or np.abs(position).max() > _FARTHEST_M:
            self.invalid += 1
            return None
        return VehicleState(boot_time_s(message), odometry)
