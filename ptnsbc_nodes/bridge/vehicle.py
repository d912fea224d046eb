"""The reports of one flight controller: state, mode, battery, origin, reboots and duplicates.

No sockets and no ROS: messages in, facts out, all times on our steady clock [s].
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, Autopilot, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.plausibility import ConfirmedValue
from ptnsbc_nodes.bridge.pose import Pose, VehicleState, boot_time_s

_MILLI, _CENTI = 1e-3, 1e-2
_NO_VOLTAGE = 65535  # UINT16_MAX: not sent
_DEGREES_E7 = 1e-7
_BACKWARDS_S = 0.5
_YOUNG_S = 60.0  # a clock that shows more has not just begun
_DUPLICATE_STEPS, _DUPLICATE_WINDOW_S = 3, 3.0
_FIX_3D = 3
_FIXES = {
    1: "none",
    2: "2D",
    _FIX_3D: "3D",
    4: "DGPS",
    5: "RTK float",
    6: "RTK fixed",
    7: "static",
    8: "PPP",
}
_NO_FIX_S = 1.0
_LOW_BATTERY_S = 3.0

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


class Battery(NamedTuple):
    """The battery, as the vehicle reports it; None is a figure that it does not know."""

    voltage_v: float | None
    current_a: float | None  # drawn from it
    percent: float | None  # left


class Anchor(NamedTuple):
    """A point known in both frames."""

    place: GeoPoint
    local_enu: Array  # (3,) the same point in the vehicle's local frame [m]


class _BootClock:
    """The vehicle's time since boot: notices when it begins anew, and when it jumps to and fro."""

    def __init__(self) -> None:
        self._newest: tuple[float, float] | None = None  # time since boot, and when it arrived
        self._unexpected_s: float | None = None  # a time since boot that does not follow it
        self.restarted_s: float | None = None
        self._backward_steps: deque[float] = deque(maxlen=_DUPLICATE_STEPS)

    def update(self, boot_s: float, now_s: float) -> bool:
        """Take a time since boot; returns whether it stepped back once.

        One step back is an accident; two in a row are another boot. Messages that were held up make no
        step: they arrive late, but in their order.
        """
        last_s, arrived_s = self._newest or (boot_s, now_s)
        step_s, elapsed_s = boot_s - last_s, now_s - arrived_s
        if -_BACKWARDS_S <= step_s <= elapsed_s + _BACKWARDS_S:
            self._newest, self._unexpected_s = (boot_s, now_s), None
            return False
        went_back = step_s < 0.0
        before_s, self._unexpected_s = self._unexpected_s, boot_s
        if before_s is not None and abs(boot_s - before_s) < _BACKWARDS_S:
            # A clock that shows its old time again has not begun anew: forged messages looked like it.
            self.restarted_s = now_s if went_back and boot_s < _YOUNG_S else None
            self._newest, self._unexpected_s = (boot_s, now_s), None
            return False
        if went_back:
            self._backward_steps.append(now_s)
        return went_back

    @property
    def young(self) -> bool:
        """True if the vehicle has not been up for long, by its own clock; False while that is not known."""
        return self._newest is not None and self._newest[0] < _YOUNG_S

    def jumps_to_and_fro(self, now_s: float) -> bool:
        """True if the time has stepped back several times just now."""
        steps = self._backward_steps
        return len(steps) == _DUPLICATE_STEPS and now_s - steps[0] <= _DUPLICATE_WINDOW_S


class VehicleMonitor:
    """The newest facts about one vehicle."""

    def __init__(self, autopilot: Autopilot, *, signed: bool = True) -> None:
        """`signed`: whether every message can be believed; otherwise a change needs two messages."""
        self.autopilot = autopilot
        self.heartbeat_s: float | None = None
        self.wrong_vehicle = ""  # why this is not the expected vehicle
        self.mode = FlightMode.OTHER
        self.mode_name = ""
        self.armed = False
        self.landed: bool | None = None
        self.battery: Battery | None = None
        self.anchor: Anchor | None = None
        self.warning = ""  # newest STATUSTEXT that is a warning or an error
        self.unhealthy = (
            ""  # what SYS_STATUS reports as not healthy; PX4 tells a companion no other reason
        )
        self.fix = ""  # of the GNSS receiver; empty without one
        self.position_error_m: float | None = None  # horizontally, as the receiver estimates it
        self.pose = Pose(signed=signed)
        self._confirmed: Mapping[str, ConfirmedValue] | None = (
            None if signed else defaultdict(ConfirmedValue)
        )
        self._clock = _BootClock()
        self._booting = False
        self._had_fix = False
        self._no_fix_since_s: float | None = None
        self._low_battery_since_s: float | None = None
        self._chunks: dict[int, str] = {}

    def heartbeat_age_s(self, now_s: float) -> float:
        """Infinite before the first HEARTBEAT."""
        return float("inf") if self.heartbeat_s is None else now_s - self.heartbeat_s

    def fix_lost(self, now_s: float) -> bool:
        """True if a GPS fix is gone; a vehicle that never had one needs none."""
        since_s = self._no_fix_since_s
        return self._had_fix and since_s is not None and now_s - since_s >= _NO_FIX_S

    @property
    def battery_percent(self) -> float | None:
        """The remaining charge of the battery."""
        return None if self.battery is None else self.battery.percent

    def battery_below(self, percent: float, now_s: float) -> bool:
        """True if the battery has been below `percent` for some seconds."""
        if self.battery_percent is None or self.battery_percent >= percent:
            self._low_battery_since_s = None
            return False
        if self._low_battery_since_s is None:
            self._low_battery_since_s = now_s
        return now_s - self._low_battery_since_s >= _LOW_BATTERY_S

    def duplicate_sysid(self, now_s: float) -> bool:
        """True if two vehicles speak with one id: the time since boot jumps to and fro."""
        return self._clock.jumps_to_and_fro(now_s)

    @property
    def rebooted(self) -> bool:
        """True if the vehicle's clock began anew and it is disarmed since, or it says BOOT with a young clock.

        A disarmed PX4 says UNINIT while its checks fail, so that is no sign of a boot.
        """
        restarted_s, heartbeat_s = self._clock.restarted_s, self.heartbeat_s
        heard_since = (
            restarted_s is not None and heartbeat_s is not None and heartbeat_s >= restarted_s
        )
        return (self._booting and self._clock.young) or (not self.armed and heard_since)

    @property
    def unconfirmed(self) -> bool:
        """True if the newest HEARTBEAT brought a change that the next one must confirm."""
        return self._confirmed is not None and self._confirmed["heartbeat"].unconfirmed

    def on_message(self, message: Any, now_s: float) -> VehicleState | None:
        """Take in a message; returns the vehicle's new state when the message completes one."""
        handler = _HANDLERS.get(message.get_type())
        return handler(self, message, now_s) if handler else None

    def _believed(self, kind: str, value: Hashable) -> bool:
        return self._confirmed is None or self._confirmed[kind].accepts(value)

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return  # a gimbal or a camera with the autopilot's component id
        m = message
        value = (m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status)
        if not self._believed("heartbeat", value):
            return
        self.heartbeat_s = now_s
        self.wrong_vehicle = self._mismatch(message)
        self._booting = message.system_status == mavlink.MAV_STATE_BOOT
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.mode = self.autopilot.mode(message.base_mode, message.custom_mode)
        self.mode_name = (
            self.autopilot.own_mode
            if self.mode is FlightMode.OWN
            else f"{self.mode.value} (custom_mode {message.custom_mode})"
        )

    def _mismatch(self, message: Any) -> str:
        if message.autopilot != self.autopilot.number:
            known = {a.number: a.name for a in AUTOPILOTS.values()}
            found = known.get(message.autopilot, "unknown")
            return (
                f"MAV_AUTOPILOT {message.autopilot} ({found}): expected "
                f"{self.autopilot.name}, see mavlink.autopilot"
            )
        if message.type not in _MULTIROTORS:
            return f"MAV_TYPE {message.type}: expected a multirotor"
        return ""

    def _on_time(self, message: Any, now_s: float) -> None:
        if self._clock.update(boot_time_s(message), now_s):
            self.pose.forget_attitude()

    def _on_attitude(self, message: Any, now_s: float) -> None:
        self._on_time(message, now_s)
        self.pose.on_attitude(message, now_s)

    def _on_position(self, message: Any, now_s: float) -> VehicleState | None:
        self._on_time(message, now_s)
        return self.pose.on_position(message, now_s)

    def _on_odometry(self, message: Any, now_s: float) -> VehicleState | None:
        self._on_time(message, now_s)
        return self.pose.on_odometry(message, now_s)

    def _on_origin(self, message: Any, now_s: float) -> None:
        place = _place(message)
        if self._believed("origin", place):
            self.anchor = Anchor(place, np.zeros(3))

    def _on_home(self, message: Any, now_s: float) -> None:
        if self.anchor is None or self.anchor.local_enu.any():
            local = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
            place = _place(message)
            if self._believed("home", (place, *local.tolist())):
                self.anchor = Anchor(place, local)

    def _on_landed(self, message: Any, now_s: float) -> None:
        state = message.landed_state
        if self._believed("landed", state):
            unknown = state == mavlink.MAV_LANDED_STATE_UNDEFINED
            self.landed = None if unknown else state == mavlink.MAV_LANDED_STATE_ON_GROUND

    def _on_status(self, message: Any, now_s: float) -> None:
        self._on_battery(message, now_s)
        present = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled
        self.unhealthy = ", ".join(_sensors(present & ~message.onboard_control_sensors_health))

    def _on_battery(self, message: Any, now_s: float) -> None:
        """SYS_STATUS, in which -1 and the largest voltage stand for a figure that is not known."""
        volts, amperes, percent = (
            message.voltage_battery,
            message.current_battery,
            message.battery_remaining,
        )
        self.battery = Battery(
            volts * _MILLI if 0 < volts < _NO_VOLTAGE else None,
            amperes * _CENTI if amperes >= 0 else None,
            float(percent) if 0 <= percent <= 100 else self.battery_percent,
        )

    def _on_cells(self, message: Any, now_s: float) -> None:
        """BATTERY_STATUS: its share counts; voltage and current are those of SYS_STATUS."""
        percent = message.battery_remaining
        if 0 <= percent <= 100:
            known = self.battery or Battery(None, None, None)
            self.battery = known._replace(percent=float(percent))

    def _on_gps(self, message: Any, now_s: float) -> None:
        if message.h_acc > 0:
            self.position_error_m = message.h_acc * _MILLI
        self.fix = _FIXES.get(message.fix_type, "")
        if message.fix_type >= _FIX_3D:
            self._had_fix, self._no_fix_since_s = True, None
        elif self._no_fix_since_s is None:
            self._no_fix_since_s = now_s

    def _on_text(self, message: Any, now_s: float) -> None:
        """STATUSTEXT; PX4 sends long texts in chunks, with a tab at the end."""
        if message.severity > mavlink.MAV_SEVERITY_WARNING:
            return
        text = str(message.text)
        if getattr(message, "id", 0):
            text = self._chunks.get(message.id, "") * bool(message.chunk_seq) + text
            self._chunks = {message.id: text}
        self.warning = text.strip()


def _place(message: Any) -> GeoPoint:
    return GeoPoint(
        message.latitude * _DEGREES_E7, message.longitude * _DEGREES_E7, message.altitude * _MILLI
    )


def _sensors(bits: int) -> Iterator[str]:
    """The names of bits of MAV_SYS_STATUS_SENSOR."""
    for bit, entry in mavlink.enums["MAV_SYS_STATUS_SENSOR"].items():
        if bit and bits & bit == bit:
            name = entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_")
            yield name.lower().replace("_", " ")


_HANDLERS: Mapping[str, Callable[[VehicleMonitor, Any, float], VehicleState | None]] = {
    "HEARTBEAT": VehicleMonitor._on_heartbeat,
    "SYSTEM_TIME": VehicleMonitor._on_time,
    "ATTITUDE": VehicleMonitor._on_attitude,
    "ATTITUDE_QUATERNION": VehicleMonitor._on_attitude,
    "LOCAL_POSITION_NED": VehicleMonitor._on_position,
    "ODOMETRY": VehicleMonitor._on_odometry,
    "GPS_GLOBAL_ORIGIN": VehicleMonitor._on_origin,
    "HOME_POSITION": VehicleMonitor._on_home,
    "EXTENDED_SYS_STATE": VehicleMonitor._on_landed,
    "SYS_STATUS": VehicleMonitor._on_status,
    "BATTERY_STATUS": VehicleMonitor._on_cells,
    "GPS_RAW_INT": VehicleMonitor._on_gps,
    "STATUSTEXT": VehicleMonitor._on_text,
}
VEHICLE_MESSAGES = tuple(_HANDLERS)
