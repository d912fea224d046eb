"""What one flight controller has told: state, mode, battery, origin, and its oddities.

No sockets and no ROS: messages in, facts out, all times on our steady clock [s].
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, Autopilot, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.plausibility import ConfirmedValue
from ptnsbc_nodes.bridge.pose import Pose, VehicleState

_MILLI, _MICRO = 1e-3, 1e-6
_DEGREES_E7 = 1e-7
_BACKWARDS_S = 0.5
_YOUNG_S = 60.0  # a clock that shows more has not just begun
_TWIN_STEPS, _TWIN_WINDOW_S = 3, 3.0
_FIX_3D = 3
_NO_FIX_S = 1.0
_LOW_BATTERY_S = 3.0
_WARNING = mavlink.MAV_SEVERITY_WARNING

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


class Anchor(NamedTuple):
    """A point known in both frames."""

    place: GeoPoint
    local_enu: Array  # (3,) the same point in the vehicle's local frame [m]


class _Told(NamedTuple):
    """What counts on an unsigned link when it was said twice."""

    state: ConfirmedValue
    origin: ConfirmedValue
    home: ConfirmedValue
    landed: ConfirmedValue


class VehicleMonitor:
    """The newest of everything from one vehicle."""

    def __init__(self, autopilot: Autopilot, *, signed: bool = True) -> None:
        """`signed`: whether every message can be believed; otherwise changes need two."""
        self._autopilot = autopilot
        self.heartbeat_s: float | None = None
        self.stranger = ""
        self.mode = FlightMode.OTHER
        self.mode_name = ""
        self.armed = False
        self.landed: bool | None = None
        self.battery_percent: float | None = None
        self.anchor: Anchor | None = None
        self.text = ""  # newest warning or error
        self.pose = Pose(signed=signed)
        self._told = (
            None
            if signed
            else _Told(ConfirmedValue(), ConfirmedValue(), ConfirmedValue(), ConfirmedValue())
        )
        self._boot: tuple[float, float] | None = None  # newest time since boot, and when it came
        self._odd_boot_s: float | None = None  # one that does not follow it
        self._restarted_s: float | None = None
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
        """Whether the vehicle says so, or time since boot began anew and it is disarmed since."""
        return self._booting or (not self.armed and self._after_restart())

    def _after_restart(self) -> bool:
        restarted_s, heartbeat_s = self._restarted_s, self.heartbeat_s
        return restarted_s is not None and heartbeat_s is not None and heartbeat_s >= restarted_s

    @property
    def unconfirmed(self) -> bool:
        """Whether a HEARTBEAT has told something new that the next one must confirm."""
        return self._told is not None and self._told.state.doubts

    def hear(self, message: Any, now_s: float) -> VehicleState | None:
        """Take a message in; a new state of the vehicle when it completes one."""
        handler = _HANDLERS.get(message.get_type())
        return handler(self, message, now_s) if handler else None

    def _heartbeat(self, message: Any, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return  # a gimbal or a camera with the autopilot's component id
        m = message
        told = (m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status)
        if self._told is not None and not self._told.state.admits(told):
            return
        self.heartbeat_s = now_s
        self.stranger = self._strangeness(message)
        self._booting = message.system_status in _BOOTING
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.mode = self._autopilot.mode(message.base_mode, message.custom_mode)
        self.mode_name = (
            self._autopilot.own_mode
            if self.mode is FlightMode.OWN
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
        """Notice a clock that steps back; once is an accident, twice in a row another boot.

        Messages that were held up make no step: they are late, and still in their order.
        """
        last_s, heard_s = self._boot or (boot_s, now_s)
        step_s, elapsed_s = boot_s - last_s, now_s - heard_s
        if -_BACKWARDS_S <= step_s <= elapsed_s + _BACKWARDS_S:
            self._boot, self._odd_boot_s = (boot_s, now_s), None
            return
        went_back = step_s < 0.0
        odd_s, self._odd_boot_s = self._odd_boot_s, boot_s
        if odd_s is not None and abs(boot_s - odd_s) < _BACKWARDS_S:
            if went_back and boot_s < _YOUNG_S:
                self._restarted_s = now_s
            self._boot, self._odd_boot_s = (boot_s, now_s), None
        elif went_back:
            self._backwards.append(now_s)
            self.pose.forget_attitude()

    def _on_system_time(self, message: Any, now_s: float) -> None:
        self._time(message.time_boot_ms * _MILLI, now_s)

    def _on_pose(self, message: Any, now_s: float) -> VehicleState | None:
        kind = message.get_type()
        odometry = kind == "ODOMETRY"
        self._time(message.time_usec * _MICRO if odometry else message.time_boot_ms * _MILLI, now_s)
        if odometry:
            return self.pose.on_odometry(message, now_s)
        if kind == "LOCAL_POSITION_NED":
            return self.pose.on_position(message, now_s)
        self.pose.on_attitude(message, now_s)
        return None

    def _on_origin(self, message: Any, now_s: float) -> None:
        place = _place(message)
        if self._told is None or self._told.origin.admits(place):
            self.anchor = Anchor(place, np.zeros(3))

    def _on_home(self, message: Any, now_s: float) -> None:
        if self.anchor is None or self.anchor.local_enu.any():
            local = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
            place = _place(message)
            if self._told is None or self._told.home.admits((place, *local.tolist())):
                self.anchor = Anchor(place, local)

    def _on_landed(self, message: Any, now_s: float) -> None:
        if self._told is not None and not self._told.landed.admits(message.landed_state):
            return
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


_HANDLERS: Mapping[str, Callable[[VehicleMonitor, Any, float], VehicleState | None]] = {
    "HEARTBEAT": VehicleMonitor._heartbeat,
    "SYSTEM_TIME": VehicleMonitor._on_system_time,
    "ATTITUDE": VehicleMonitor._on_pose,
    "ATTITUDE_QUATERNION": VehicleMonitor._on_pose,
    "LOCAL_POSITION_NED": VehicleMonitor._on_pose,
    "ODOMETRY": VehicleMonitor._on_pose,
    "GPS_GLOBAL_ORIGIN": VehicleMonitor._on_origin,
    "HOME_POSITION": VehicleMonitor._on_home,
    "EXTENDED_SYS_STATE": VehicleMonitor._on_landed,
    "SYS_STATUS": VehicleMonitor._on_battery,
    "BATTERY_STATUS": VehicleMonitor._on_battery,
    "GPS_RAW_INT": VehicleMonitor._on_gps,
    "STATUSTEXT": VehicleMonitor._on_text,
}
