"""The reports of one flight controller: its pose in its own local frame, mode, battery, GNSS, origin, reboots.

No sockets and no ROS: messages in, facts out, all times on our steady clock [s].

A checksum of 16 bits accepts one broken packet in 65536. On an unsigned link a value that contradicts the previous one
is therefore accepted only when the next message confirms it: a vehicle repeats its state, a broken packet is not
repeated. A real change is delayed by one message: 20 ms for a position, one request and its answer for a mode.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, Autopilot
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.timesync import VehicleClock
from ptnsbc_nodes.bridge.procedure.steps import Lasting

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


# Of SYS_STATUS. Battery and GNSS have rules of their own; no formation needs a fence, a log or a remote control.
_FLIES_BY = (
    "3d gyro", "3d accel", "3d mag", "3d gyro2", "3d accel2", "3d mag2", "absolute pressure", "vision position",
    "xy position control", "z altitude control", "motor outputs", "ahrs",
)  # fmt: skip
# ArduCopter says that something is well again as loudly as it said that it was not.
_ENDS = re.compile(r"(EKF Failsafe|Glitch) cleared|Dead Reckoning stopped|compensation OFF", re.I)
_NO_VOLTAGE = 65535  # UINT16_MAX: not sent
_FIX_3D = 3
_FIXES = ("", "none", "2D", "3D", "DGPS", "RTK float", "RTK fixed", "static", "PPP")
_NO_FIX_S = 1.0
_LOW_BATTERY_S = 3.0
_ROTORS = "GENERIC QUADROTOR COAXIAL HEXAROTOR OCTOROTOR TRICOPTER DODECAROTOR DECAROTOR"
_MULTIROTORS = [getattr(mavlink, f"MAV_TYPE_{name}") for name in _ROTORS.split()]


class Battery(NamedTuple):
    """The battery, as the vehicle reports it; None is a figure that it does not know."""

    voltage_v: float | None = None
    current_a: float | None = None  # drawn from it
    percent: float | None = None  # left


class Anchor(NamedTuple):
    """A point known in both frames."""

    place: GeoPoint
    local_enu: Array  # (3,) the same point in the vehicle's local frame [m]


class BatteryMonitor:
    """The newest figures of the battery, and since when it is low."""

    def __init__(self) -> None:
        self.newest = Battery()
        self._low = Lasting()

    def low(self, percent: float, now_s: float) -> str:
        """The charge in words if it has been below `percent` for some seconds; empty otherwise."""
        left = self.newest.percent
        low_s = self._low.update(left is not None and left < percent, now_s)
        return f"battery at {left:.0f} %, below {percent:g}" if low_s >= _LOW_BATTERY_S else ""

    def on_status(self, message: Any) -> None:
        """SYS_STATUS, in which -1 and the largest voltage stand for a figure that is not known."""
        volts, amperes = message.voltage_battery, message.current_battery
        percent = message.battery_remaining
        self.newest = Battery(
            volts * _MILLI if 0 < volts < _NO_VOLTAGE else None,
            amperes * _CENTI if amperes >= 0 else None,
            float(percent) if 0 <= percent <= 100 else self.newest.percent,
        )

    def on_cells(self, message: Any) -> None:
        """BATTERY_STATUS: its share counts; voltage and current are those of SYS_STATUS."""
        if 0 <= message.battery_remaining <= 100:
            percent = float(message.battery_remaining)
            self.newest = self.newest._replace(percent=percent)


class GnssMonitor:
    """The receiver of the vehicle; `fix` is empty without one."""

    def __init__(self) -> None:
        self.fix = ""
        self.error_m: float | None = None  # horizontally, as the receiver estimates it
        self._had_fix = False
        self._without_fix = Lasting()

    def fix_lost(self, now_s: float) -> bool:
        """True if a fix is gone; a vehicle that never had one needs none."""
        return self._had_fix and self._without_fix.seconds(now_s) >= _NO_FIX_S

    def on_message(self, message: Any, now_s: float) -> None:
        """GPS_RAW_INT."""
        if message.h_acc > 0:
            self.error_m = message.h_acc * _MILLI
        self.fix = _FIXES[message.fix_type] if message.fix_type < len(_FIXES) else ""
        fixed = message.fix_type >= _FIX_3D
        self._had_fix = self._had_fix or fixed
        self._without_fix.update(not fixed, now_s)


class VehicleMonitor:
    """The newest facts about one vehicle."""

    def __init__(self, autopilot: Autopilot, *, signed: bool = True) -> None:
        """`signed`: whether every message can be believed; otherwise a change needs two messages."""
        self.autopilot = autopilot
        self.heartbeat_s: float | None = None
        self.wrong_vehicle = ""  # why this is not the expected vehicle
        self.missing = ""  # what its link knows to be missing
        self.mode_name = ""
        self.armed = False
        self._state: int | None = None  # MAV_STATE
        self._prearm_failed = False  # by SYS_STATUS
        self.landed: bool | None = None
        self.anchor: Anchor | None = None
        self.warning = ""  # newest STATUSTEXT that is a warning or an error
        self.unhealthy = ""  # by SYS_STATUS; PX4 tells a companion no other reason
        self.failed = ""
        """Those of it by which it flies, and which were healthy before it was armed."""
        self._unhealthy_before: list[str] | None = None
        self.alarm = "", float("-inf")
        """Newest STATUSTEXT that is critical or worse, and when it came."""
        self.battery = BatteryMonitor()
        self.gnss = GnssMonitor()
        self.pose = Pose(signed=signed)
        self._signed = signed
        self._confirmed: Mapping[str, ConfirmedValue] = defaultdict(ConfirmedValue)
        self._chunks: dict[int, str] = {}

    def heartbeat_age_s(self, now_s: float) -> float:
        """Infinite before the first HEARTBEAT."""
        return float("inf") if self.heartbeat_s is None else now_s - self.heartbeat_s

    @property
    def mode(self) -> FlightMode:
        """The mode, as far as the bridge distinguishes them."""
        return FlightMode.named(self.mode_name)

    @property
    def unready(self) -> str:
        """The reason why it would refuse to arm, as its HEARTBEAT or its SYS_STATUS says; empty where neither does."""
        if self._prearm_failed:
            return "its pre-arm check fails"
        # A controller without a pre-arm check may leave the state uninitialised for ever.
        checked = not self.autopilot.attitude_only and not self.armed
        ready = self._state in (None, mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE)
        return f"MAV_STATE {self._state}: expected STANDBY" if checked and not ready else ""

    @property
    def rebooted(self) -> bool:
        """True if the vehicle's clock began anew and it is disarmed since, or it says BOOT with a young clock.

        A disarmed PX4 says UNINIT while its checks fail, so that is no sign of a boot.
        """
        clock, heartbeat_s = self.pose.clock, self.heartbeat_s
        restarted_s = clock.restarted_s
        if self.armed or restarted_s is None or heartbeat_s is None or heartbeat_s < restarted_s:
            return self._state == mavlink.MAV_STATE_BOOT and clock.young
        return True

    @property
    def unconfirmed(self) -> bool:
        """True if the newest HEARTBEAT brought a change that the next one must confirm."""
        return not self._signed and self._confirmed["heartbeat"].unconfirmed

    def on_message(self, message: Any, now_s: float) -> VehicleState | None:
        """Take in a message; returns the vehicle's new state when the message completes one."""
        handler = _HANDLERS.get(message.get_type())
        return handler(self, message, now_s) if handler else None

    def _believes(self, kind: str, value: Hashable) -> bool:
        return self._signed or self._confirmed[kind].accepts(value)

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return  # a gimbal or a camera with the autopilot's component id
        m, autopilot = message, self.autopilot
        value = (m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status)
        if not self._believes("heartbeat", value):
            return
        self.heartbeat_s = now_s
        self._state = m.system_status
        self.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.mode_name = autopilot.mode_name(m.base_mode, m.custom_mode)
        self.wrong_vehicle = ""
        if m.autopilot != autopilot.number:
            names = {known.number: known.name for known in AUTOPILOTS.values()}
            self.wrong_vehicle = (
                f"MAV_AUTOPILOT {m.autopilot} ({names.get(m.autopilot, 'unknown')}): "
                f"expected {autopilot.name}, see mavlink.autopilot"
            )
        elif m.type not in _MULTIROTORS:
            self.wrong_vehicle = f"MAV_TYPE {m.type}: expected a multirotor"

    def _on_anchor(self, message: Any, now_s: float) -> None:
        """GPS_GLOBAL_ORIGIN, and HOME_POSITION as long as there is none."""
        local, kind = np.zeros(3), message.get_type()
        if kind == "HOME_POSITION":
            if self.anchor is not None and not self.anchor.local_enu.any():
                return
            local = frames.vector_ned_to_enu(np.array([message.x, message.y, message.z]))
        latitude_deg, longitude_deg = message.latitude, message.longitude
        place = GeoPoint(
            latitude_deg * _DEGREES_E7, longitude_deg * _DEGREES_E7, message.altitude * _MILLI
        )
        if self._believes(kind, (place, *local.tolist())):
            self.anchor = Anchor(place, local)

    def _on_landed(self, message: Any, now_s: float) -> None:
        state = message.landed_state
        if self._believes("landed", state):
            unknown = state == mavlink.MAV_LANDED_STATE_UNDEFINED
            self.landed = None if unknown else state == mavlink.MAV_LANDED_STATE_ON_GROUND

    def _on_status(self, message: Any, now_s: float) -> None:
        self.battery.on_status(message)
        bits = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled
        bits &= ~message.onboard_control_sensors_health
        self._prearm_failed = bool(bits & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        names = [
            entry.name.removeprefix("MAV_SYS_STATUS_")
            .removeprefix("SENSOR_")
            .lower()
            .replace("_", " ")
            for bit, entry in mavlink.enums["MAV_SYS_STATUS_SENSOR"].items()
            if bit and bits & bit == bit
        ]
        if not self.armed or self._unhealthy_before is None:
            self._unhealthy_before = names
        self.unhealthy = ", ".join(names)
        new = (name for name in names if name not in self._unhealthy_before)
        self.failed = ", ".join(name for name in new if name in _FLIES_BY)

    def _on_text(self, message: Any, now_s: float) -> None:
        """STATUSTEXT; PX4 sends long texts in chunks, with a tab at the end."""
        if message.severity > mavlink.MAV_SEVERITY_WARNING:
            return
        text = str(message.text)
        if getattr(message, "id", 0):
            text = self._chunks.get(message.id, "") * bool(message.chunk_seq) + text
            self._chunks = {message.id: text}
        self.warning = text.strip()
        if message.severity <= mavlink.MAV_SEVERITY_CRITICAL and not _ENDS.search(self.warning):
            self.alarm = (self.warning, now_s)


_HANDLERS: Mapping[str, Callable[[VehicleMonitor, Any, float], VehicleState | None]] = {
    "HEARTBEAT": VehicleMonitor._on_heartbeat,
    "SYSTEM_TIME": lambda vehicle, message, now_s: vehicle.pose.on_time(message, now_s),
    "ATTITUDE": lambda vehicle, message, now_s: vehicle.pose.on_attitude(message, now_s),
    "ATTITUDE_QUATERNION": lambda vehicle, message, now_s: vehicle.pose.on_attitude(message, now_s),
    "LOCAL_POSITION_NED": lambda vehicle, message, now_s: vehicle.pose.on_position(message, now_s),
    "ODOMETRY": lambda vehicle, message, now_s: vehicle.pose.on_odometry(message, now_s),
    "GPS_GLOBAL_ORIGIN": VehicleMonitor._on_anchor,
    "HOME_POSITION": VehicleMonitor._on_anchor,
    "EXTENDED_SYS_STATE": VehicleMonitor._on_landed,
    "SYS_STATUS": VehicleMonitor._on_status,
    "BATTERY_STATUS": lambda vehicle, message, _: vehicle.battery.on_cells(message),
    "GPS_RAW_INT": lambda vehicle, message, now_s: vehicle.gnss.on_message(message, now_s),
    "STATUSTEXT": VehicleMonitor._on_text,
}
VEHICLE_MESSAGES = tuple(_HANDLERS)
