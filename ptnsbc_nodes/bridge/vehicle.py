"""What one flight controller has told: state, mode, battery, origin, and its oddities.

No sockets and no ROS: messages in, facts out, all times on our steady clock [s].
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_nodes.mavlink import frames
from ptnsbc_nodes.mavlink.autopilots import AUTOPILOTS, Autopilot, Mode
from ptnsbc_nodes.mavlink.dialect import mavlink
from ptnsbc_nodes.mavlink.frames import GeoPoint

_MILLI, _MICRO = 1e-3, 1e-6
_DEGREES_E7 = 1e-7
_BACKWARDS_S = 0.5
_TWIN_STEPS, _TWIN_WINDOW_S = 3, 3.0
_ATTITUDE_AGE_S = 0.2
_FIX_3D = 3
_NO_FIX_S = 1.0
_LOW_BATTERY_S = 3.0
_WARNING = mavlink.MAV_SEVERITY_WARNING
_FARTHEST_M = 1e5
_NORM_SLACK = 0.05

_BOOTING = (
    mavlink.MAV_STATE_UNINIT,
    mavlink.MAV_STATE_BOOT,
    mavlink.MAV_STATE_CALIBRATING,
)
_MULTIROTORS = (
    mavlink.MAV_TYPE_GENERIC,
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
)


class Sample(NamedTuple):
    """One state of the vehicle in its own local frame, axes ENU and FLU."""

    boot_s: float  # time since the vehicle's boot
    odometry: Array  # (13,)


class Anchor(NamedTuple):
    """A point known in both frames."""

    place: GeoPoint
    local_enu: Array  # (3,) the same point in the vehicle's local frame [m]


class _Attitude(NamedTuple):
    boot_s: float
    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s], FLU


class Vehicle:
    """The newest of everything from one vehicle."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self.heartbeat_s: float | None = None
        self.stranger = ""
        self.mode = Mode.OTHER
        self.mode_name = ""
        self.armed = False
        self.landed: bool | None = None
        self.battery_percent: float | None = None
        self.anchor: Anchor | None = None
        self.position_s: float | None = None  # when the newest position came
        self.text = ""  # newest warning or error
        self.invalid_samples = 0
        self._attitude: _Attitude | None = None
        self._uses_odometry = False
        self._boot_s: float | None = None
        self._booting = False
        self._backwards: deque[float] = deque(maxlen=_TWIN_STEPS)
        self._had_fix = False
        self._no_fix_since_s: float | None = None
        self._low_since_s: float | None = None
        self._chunks: dict[int, str] = {}

    def heartbeat_age_s(self, now_s: float) -> float:
        """Infinite before the first."""
        return float("inf") if self.heartbeat_s is None else now_s - self.heartbeat_s

    def fix_lost(self, now_s: float) -> bool:
        """Whether a GPS fix that was there is gone; a vehicle that never had one needs none."""
        since = self._no_fix_since_s
        return self._had_fix and since is not None and now_s - since >= _NO_FIX_S

    def battery_below(self, percent: float, now_s: float) -> bool:
        """Whether the battery has been below `percent` for a while."""
        if self.battery_percent is None or self.battery_percent >= percent:
            self._low_since_s = None
            return False
        if self._low_since_s is None:
            self._low_since_s = now_s
        return now_s - self._low_since_s >= _LOW_BATTERY_S

    def twin(self, now_s: float) -> bool:
        """Whether time since boot jumps to and fro: two vehicles speak with one id."""
        steps = self._backwards
        return len(steps) == _TWIN_STEPS and now_s - steps[0] <= _TWIN_WINDOW_S

    @property
    def rebooted(self) -> bool:
        """Whether the vehicle says so, or time since boot went back and it is disarmed since."""
        return self._booting or (bool(self._backwards) and not self.armed and self._after_step())

    def _after_step(self) -> bool:
        return self.heartbeat_s is not None and self.heartbeat_s >= self._backwards[-1]

    def hear(self, message: Any, now_s: float) -> Sample | None:
        """Take a message in; a new state of the vehicle when it completes one."""
        handler = _HANDLERS.get(message.get_type())
        return handler(self, message, now_s) if handler else None

    def _heartbeat(self, message: Any, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return  # a gimbal or a camera with the autopilot's component id
        self.heartbeat_s = now_s
        self.stranger = self._strangeness(message)
        self._booting = message.system_status in _BOOTING
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.mode = self._autopilot.mode(message.base_mode, message.custom_mode)
        self.mode_name = (
            self._autopilot.own_mode
            if self.mode is Mode.OWN
            else f"{self.mode.value} (custom_mode {message.custom_mode})"
        )

    def _strangeness(self, message: Any) -> str:
        if message.autopilot != self._autopilot.number:
            known = {a.number: a.name for a in AUTOPILOTS.values()}
            found = known.get(message.autopilot, "unknown")
            return (
                f"MAV_AUTOPILOT {message.autopilot} ({found}): expected "
                f"{self._autopilot.name}, see mavlink.autopilot"
            )
        if message.type not in _MULTIROTORS:
            return f"MAV_TYPE {message.type}: expected a multirotor"
        return ""

    def _time(self, boot_s: float, now_s: float) -> None:
        if self._boot_s is not None and boot_s < self._boot_s - _BACKWARDS_S:
            self._backwards.append(now_s)
            self._attitude = None
        self._boot_s = boot_s

    def _on_system_time(self, message: Any, now_s: float) -> None:
        self._time(message.time_boot_ms * _MILLI, now_s)

    def _on_attitude(self, message: Any, now_s: float) -> None:
        boot_s = message.time_boot_ms * _MILLI
        self._time(boot_s, now_s)
        if message.get_type() == "ATTITUDE":
            wxyz = frames.quaternion_from_euler_ned(message.roll, message.pitch, message.yaw)
        else:
            wxyz = np.array([message.q1, message.q2, message.q3, message.q4])
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        self._keep_attitude(boot_s, wxyz, rates)

    def _keep_attitude(self, boot_s: float, wxyz: Array, rates: Array) -> None:
        norm = float(np.sqrt(wxyz @ wxyz))
        if not abs(norm - 1.0) <= _NORM_SLACK or not np.isfinite(rates).all():
            self.invalid_samples += 1
            return
        self._attitude = _Attitude(
            boot_s,
            frames.quaternion_ned_frd_to_enu_flu(wxyz / norm),
            frames.vector_frd_to_flu(rates),
        )

    def _on_position(self, message: Any, now_s: float) -> Sample | None:
        boot_s = message.time_boot_ms * _MILLI
        self._time(boot_s, now_s)
        self._uses_odometry = False
        attitude = self._attitude
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        velocity = frames.vector_ned_to_enu(np.array([message.vx, message.vy, message.vz]))
        self.position_s = now_s
        if attitude is None or abs(boot_s - attitude.boot_s) > _ATTITUDE_AGE_S:
            return None
        if not np.isfinite(velocity).all():
            self.invalid_samples += 1
            return None
        turn = rotation_from_quaternion(attitude.quaternion)
        return self._sample(boot_s, position, attitude, turn.T @ velocity)

    def _on_odometry(self, message: Any, now_s: float) -> Sample | None:
        """ODOMETRY, for controllers that send neither position nor attitude alone."""
        if self.position_s is not None and not self._uses_odometry:
            return None
        if (message.frame_id, message.child_frame_id) != (
            mavlink.MAV_FRAME_LOCAL_NED,
            mavlink.MAV_FRAME_BODY_FRD,
        ):
            return None
        boot_s = message.time_usec * _MICRO
        self._time(boot_s, now_s)
        self._uses_odometry, self.position_s = True, now_s
        rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
        self._keep_attitude(boot_s, np.array(message.q), rates)
        if self._attitude is None or self._attitude.boot_s != boot_s:
            return None
        position = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        velocity = frames.vector_frd_to_flu(np.array([message.vx, message.vy, message.vz]))
        return self._sample(boot_s, position, self._attitude, velocity)

    def _sample(
        self, boot_s: float, position: Array, attitude: _Attitude, velocity_flu: Array
    ) -> Sample | None:
        odometry = np.empty(ODOMETRY_SIZE)
        odometry[0:3] = position
        odometry[3:7] = attitude.quaternion
        odometry[7:10] = velocity_flu
        odometry[10:13] = attitude.rates
        if not np.isfinite(odometry).all() or np.abs(position).max() > _FARTHEST_M:
            self.invalid_samples += 1
            return None
        return Sample(boot_s, odometry)

    def _on_origin(self, message: Any, now_s: float) -> None:
        place = _place(message)
        self.anchor = Anchor(place, np.zeros(3))

    def _on_home(self, message: Any, now_s: float) -> None:
        if self.anchor is None or self.anchor.local_enu.any():
            local = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
            self.anchor = Anchor(_place(message), local)

    def _on_landed(self, message: Any, now_s: float) -> None:
        if message.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            self.landed = None
        else:
            self.landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND

    def _on_battery(self, message: Any, now_s: float) -> None:
        if 0 <= message.battery_remaining <= 100:
            self.battery_percent = float(message.battery_remaining)

    def _on_gps(self, message: Any, now_s: float) -> None:
        if message.fix_type >= _FIX_3D:
            self._had_fix, self._no_fix_since_s = True, None
        elif self._no_fix_since_s is None:
            self._no_fix_since_s = now_s

    def _on_text(self, message: Any, now_s: float) -> None:
        """STATUSTEXT; PX4 sends long ones in chunks, with a tab at the end."""
        if message.severity > _WARNING:
            return
        text = str(message.text)
        if getattr(message, "id", 0):
            text = self._chunks.get(message.id, "") * bool(message.chunk_seq) + text
            self._chunks = {message.id: text}
        self.text = text.strip()


def _place(message: Any) -> GeoPoint:
    return GeoPoint(
        message.latitude * _DEGREES_E7, message.longitude * _DEGREES_E7, message.altitude * _MILLI
    )


_HANDLERS: Mapping[str, Callable[[Vehicle, Any, float], Sample | None]] = {
    "HEARTBEAT": Vehicle._heartbeat,
    "SYSTEM_TIME": Vehicle._on_system_time,
    "ATTITUDE": Vehicle._on_attitude,
    "ATTITUDE_QUATERNION": Vehicle._on_attitude,
    "LOCAL_POSITION_NED": Vehicle._on_position,
    "ODOMETRY": Vehicle._on_odometry,
    "GPS_GLOBAL_ORIGIN": Vehicle._on_origin,
    "HOME_POSITION": Vehicle._on_home,
    "EXTENDED_SYS_STATE": Vehicle._on_landed,
    "SYS_STATUS": Vehicle._on_battery,
    "BATTERY_STATUS": Vehicle._on_battery,
    "GPS_RAW_INT": Vehicle._on_gps,
    "STATUSTEXT": Vehicle._on_text,
}
