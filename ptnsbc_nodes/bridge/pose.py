"""Where the vehicle is, from the messages it tells it in: in its own local frame, axes ENU and FLU.

No sockets and no ROS: messages in, samples out, all times on our steady clock [s].
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
_NORM_SLACK = 0.05
# Of what a quadrotor does, an estimator that resets by decimetres included.
_PLACE = (np.array([0.2] * 3 + [0.5] * 3), np.array([15.0] * 3 + [20.0] * 3))  # [m, m/s]
_TURN = (np.array([0.1] * 6 + [1.0] * 3), np.array([5.0] * 6 + [40.0] * 3))  # [1, rad/s]


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
        self.position_s: float | None = None  # when the newest position came
        self.quaternion_s = float("-inf")  # when the newest ATTITUDE_QUATERNION came
        self.invalid = 0
        self._attitude: _Attitude | None = None
        self._uses_odometry = False
        self._places = None if signed else RateLimitedValue(*_PLACE)
        self._turns = None if signed else RateLimitedValue(*_TURN)

    @property
    def doubted(self) -> int:
        """Messages that one more would have confirmed."""
        return sum(each.doubted for each in (self._places, self._turns) if each is not None)

    def forget_attitude(self) -> None:
        """The vehicle's clock is another one now."""
        self._attitude = None

    def on_attitude(self, message: Any, now_s: float) -> None:
        """ATTITUDE or ATTITUDE_QUATERNION."""
        boot_s = message.time_boot_ms * _MILLI
        if message.get_type() == "ATTITUDE":
            wxyz = frames.quaternion_from_euler_ned(message.roll, message.pitch, message.yaw)
        else:
            self.quaternion_s = now_s
            wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        self._keep_attitude(boot_s, wxyz, rates, now_s)

    def _keep_attitude(self, boot_s: float, wxyz: Array, rates: Array, now_s: float) -> None:
        norm = float(np.sqrt(wxyz @ wxyz))
        if not abs(norm - 1.0) <= _NORM_SLACK or not np.isfinite(rates).all():
            self.invalid += 1
            return
        quaternion = frames.quaternion_ned_frd_to_enu_flu(wxyz / norm)
        turn = rotation_from_quaternion(
            quaternion
        )  # a quaternion may change its sign and mean the same
        told = np.concatenate((turn[:, 0], turn[:, 2], rates))
        if self._turns is None or self._turns.admits(told, now_s):
            self._attitude = _Attitude(boot_s, quaternion, frames.vector_frd_to_flu(rates))

    def on_position(self, message: Any, now_s: float) -> VehicleState | None:
        """LOCAL_POSITION_NED: a sample with the attitude told before."""
        boot_s = message.time_boot_ms * _MILLI
        self._uses_odometry = False
        attitude = self._attitude
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        velocity = frames.vector_ned_to_enu(np.array([message.vx, message.vy, message.vz]))
        self.position_s = now_s
        if attitude is None or abs(boot_s - attitude.boot_s) > _ATTITUDE_AGE_S:
            return None
        if not np.isfinite(velocity).all():
            self.invalid += 1
            return None
        if not self._steady(position, velocity, now_s):
            return None
        turn = rotation_from_quaternion(attitude.quaternion)
        return self._sample(boot_s, position, attitude, turn.T @ velocity)

    def on_odometry(self, message: Any, now_s: float) -> VehicleState | None:
        """ODOMETRY, for controllers that send neither position nor attitude alone."""
        if self.position_s is not None and not self._uses_odometry:
            return None
        if (message.frame_id, message.child_frame_id) != (
            mavlink.MAV_FRAME_LOCAL_NED,
            mavlink.MAV_FRAME_BODY_FRD,
        ):
            return None
        boot_s = message.time_usec * _MICRO
        self._uses_odometry, self.position_s = True, now_s
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        self._keep_attitude(boot_s, np.array(message.q), rates, now_s)
        if self._attitude is None or self._attitude.boot_s != boot_s:
            return None
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        velocity = frames.vector_frd_to_flu(np.array([message.vx, message.vy, message.vz]))
        if not self._steady(position, velocity, now_s):
            return None
        return self._sample(boot_s, position, self._attitude, velocity)

    def _steady(self, position: Array, velocity: Array, now_s: float) -> bool:
        """Whether a place and a velocity, of whatever frame, follow those before."""
        told = np.concatenate((position, velocity))
        return self._places is None or self._places.admits(told, now_s)

    def _sample(
        self, boot_s: float, position: Array, attitude: _Attitude, velocity_flu: Array
    ) -> VehicleState | None:
        odometry = np.empty(ODOMETRY_SIZE)
        odometry[0:3] = position
        odometry[3:7] = attitude.quaternion
        odometry[7:10] = velocity_flu
        odometry[10:13] = attitude.rates
        if not np.isfinite(odometry).all() or np.abs(position).max() > _FARTHEST_M:
            self.invalid += 1
            return None
        return VehicleState(boot_s, odometry)
