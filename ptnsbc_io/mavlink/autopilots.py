"""The differences between autopilots: modes, parameters and their encodings, velocity loops, and what they mean.

PX4: docs.px4.io, Offboard Mode and Parameter Reference. ArduCopter: ardupilot.org, Copter Commands in Guided Mode and
Complete Parameter List; 4.7 renamed WPNAV_* (centimetres) to WP_* (metres).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.link import V2

_RETRY_S = 0.5
_MAX_REQUESTS = 4
_PARALLEL = 4

_INTEGERS: Mapping[int, str] = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


class MavlinkParameterError(PtnsbcError):
    """A parameter has an unknown type."""


def decoded(message: Any, *, bytewise: bool) -> float:
    """The value of a PARAM_VALUE; `bytewise`: integers travel as their bytes, else as a float of the same value."""
    kind, data = message.param_type, bytes(message.get_msgbuf())
    if kind not in _INTEGERS and kind != mavlink.MAV_PARAM_TYPE_REAL32:
        raise MavlinkParameterError(
            f"parameter of type {kind}: expected REAL32 or an integer of 32 bits"
        )
    # The four bytes as they were sent: a float in between may change the bits of a NaN.
    at, form = 10 if data[0] == V2 else 6, _INTEGERS.get(kind, "<f") if bytewise else "<f"
    return float(struct.unpack(form, data[at : at + 4].ljust(4, b"\0"))[0])


def current_name(name: str) -> tuple[str, float]:
    """The name of a parameter in the newest version, and the unit of its value there."""
    return _OLD_NAMES.get(name, (name, 1.0))


class ParameterReader:
    """Requests parameters, a few at a time, and stores the answers.

    An autopilot does not answer for a name that it does not have: after four requests without an
    answer a parameter counts as missing.
    """

    def __init__(self, names: Sequence[str], *, bytewise: bool) -> None:
        self._bytewise = bytewise
        self._requests = dict.fromkeys(names, 0)
        self._next_s = dict.fromkeys(names, 0.0)
        self.values: dict[str, float] = {}

    @property
    def missing(self) -> list[str]:
        """Names without an answer; of an old and a new name one is enough."""
        return [name for name in self._requests if current_name(name)[0] not in self.values]

    def done(self, now_s: float) -> bool:
        """True if every name is answered or given up."""
        return all(
            self._requests[name] >= _MAX_REQUESTS and now_s >= self._next_s[name]
            for name in self.missing
        )

    def due(self, now_s: float) -> Iterator[str]:
        """Names to request now."""
        open_names = [n for n in self.missing if self._requests[n] < _MAX_REQUESTS]
        for name in open_names[:_PARALLEL]:
            if now_s >= self._next_s[name]:
                self._requests[name] += 1
                self._next_s[name] = now_s + _RETRY_S
                yield name

    def on_param_value(self, message: Any) -> None:
        """Store a PARAM_VALUE if it was requested; only the first answer counts, and none that is no number."""
        name = str(message.param_id)
        current, unit = current_name(name)
        if self._requests.get(name) and current not in self.values:
            value = unit * decoded(message, bytewise=self._bytewise)
            if math.isfinite(value):
                self.values[current] = value


_DEGREE = 0.017453292519943295
_THRUST_AS_THRUST = 8  # bit 3 of GUID_OPTIONS


class SetpointLimits(NamedTuple):
    """Limits of a vehicle, by its parameters, for what may be sent to it; infinite where not known."""

    horizontal_m_s: float
    up_m_s: float
    down_m_s: float
    acceleration_m_s2: float
    tilt_rad: float

    @property
    def planner_m_s(self) -> float:
        """Speed limit for the planner, which knows one number only; descents are clamped besides."""
        return min(self.horizontal_m_s, self.up_m_s)


class Rates(Enum):
    """The body rates that an autopilot uses beside an attitude."""

    ALL = "all"
    HEADING = "heading"  # PX4: the yaw rate alone, about the vertical
    HEADING_BY_ALL = (
        "heading by all"  # ArduCopter: all three or none; the frame depends on the version
    )


class Autopilot(NamedTuple):
    """One kind of autopilot."""

    name: str
    number: int  # MAV_AUTOPILOT
    own_mode: str  # name of the mode that follows setpoints
    modes: Mapping[tuple[int, int], str]  # names by main and sub mode; `-`: none
    packed: bool  # custom_mode holds main in its third byte and sub in its fourth
    bytewise: bool  # of the integers among its parameters
    stream_first: bool  # its mode needs setpoints before and during, and it takes off by one; else by NAV_TAKEOFF
    attitude_only: bool
    integrates: bool  # an acceleration beside a velocity changes it, also when no setpoint follows
    rates: Rates
    parameters: tuple[str, ...]
    land_s: float = (
        10.0  # still in its own mode after so long without setpoints, it is told to land
    )

    @property
    def returns(self) -> bool:
        """True if it flies home by a mode of its own, as RTL."""
        return self.number in (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        """The name of the mode in a HEARTBEAT."""
        if self.attitude_only:
            guided = base_mode & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            return self.own_mode if guided else f"not {self.own_mode}"
        numbers = (custom_mode, 0)
        if self.packed:
            numbers = (custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
        return self.modes.get(numbers, f"custom_mode {custom_mode}")

    def mode_numbers(self, mode: FlightMode) -> tuple[int, int]:
        """Main and sub mode with which to request a mode: `param2` and `param3` of MAV_CMD_DO_SET_MODE."""
        return next(
            numbers for numbers, name in self.modes.items() if FlightMode.named(name) is mode
        )


_OLD_NAMES: Mapping[str, tuple[str, float]] = {
    "WPNAV_SPEED": ("WP_SPD", 0.01),
    "WPNAV_SPEED_UP": ("WP_SPD_UP", 0.01),
    "WPNAV_SPEED_DN": ("WP_SPD_DN", 0.01),
    "WPNAV_ACCEL": ("WP_ACC", 0.01),
    "ANGLE_MAX": ("ATC_ANGLE_MAX", 0.01),
    "PSC_POSXY_P": ("PSC_NE_POS_P", 1.0),
    "PSC_VELXY_P": ("PSC_NE_VEL_P", 1.0),
    "PSC_VELXY_I": ("PSC_NE_VEL_I", 1.0),
    "PSC_VELXY_D": ("PSC_NE_VEL_D", 1.0),
    "PSC_JERK_XY": ("PSC_JERK_NE", 1.0),
    "RTL_ALT": ("RTL_ALT_M", 0.01),
}
"""Parameters of ArduCopter before 4.7: their names since, and the unit of an old value in that of a new one."""
_PX4_MAIN = "- MANUAL ALTCTL POSCTL - ACRO OFFBOARD STABILIZED RATTITUDE SIMPLE TERMINATION"
_PX4_POSITION = "POSCTL ORBIT POSCTL_SLOW"
_PX4_AUTO = (
    "- READY TAKEOFF HOLD MISSION RTL LAND - FOLLOW PRECLAND VTOL_TAKEOFF EXTERNAL1 EXTERNAL2 EXTERNAL3 EXTERNAL4 "
    "EXTERNAL5 EXTERNAL6 EXTERNAL7 EXTERNAL8"
)
_ARDUCOPTER = (
    "STABILIZE ACRO ALT_HOLD AUTO GUIDED LOITER RTL CIRCLE - LAND - DRIFT - SPORT FLIP AUTOTUNE POSHOLD BRAKE THROW "
    "AVOID_ADSB GUIDED_NOGPS SMART_RTL FLOWHOLD FOLLOW ZIGZAG SYSTEMID AUTOROTATE AUTO_RTL TURTLE RATE_ACRO"
)
PX4 = Autopilot(
    name="px4",
    number=mavlink.MAV_AUTOPILOT_PX4,
    own_mode="OFFBOARD",
    modes={
        **{(n, 0): name for n, name in enumerate(_PX4_MAIN.split())},
        **{(3, n): name for n, name in enumerate(_PX4_POSITION.split())},
        **{(4, n): name for n, name in enumerate(_PX4_AUTO.split())},
    },
    packed=True,
    bytewise=True,
    stream_first=True,
    attitude_only=False,
    integrates=False,
    rates=Rates.HEADING,
    parameters=(
        "COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_RCL_EXCEPT", "NAV_DLL_ACT", "COM_DISARM_PRFLT", "MPC_XY_VEL_MAX",
        "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN", "MPC_ACC_HOR_MAX", "MPC_ACC_UP_MAX", "MPC_TILTMAX_AIR", "MPC_THR_HOVER",
        "MPC_XY_VEL_P_ACC", "MPC_XY_VEL_I_ACC", "MPC_XY_VEL_D_ACC", "MC_ROLL_P", "RTL_RETURN_ALT",
    ),
)  # fmt: skip
ARDUPILOT = Autopilot(
    name="ardupilot",
    number=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    own_mode="GUIDED",
    modes={(n, 0): name for n, name in enumerate(_ARDUCOPTER.split())},
    packed=False,
    bytewise=False,
    stream_first=False,
    attitude_only=False,
    integrates=True,
    rates=Rates.HEADING_BY_ALL,
    parameters=(
        "GUID_TIMEOUT", "GUID_OPTIONS", "MOT_THST_HOVER", "FS_EKF_ACTION", "FS_GCS_ENABLE", "BATT_FS_LOW_ACT",
        "ATC_INPUT_TC", *_OLD_NAMES, *(name for name, _ in _OLD_NAMES.values()),
    ),
)  # fmt: skip
GENERIC = Autopilot(
    name="generic",
    number=mavlink.MAV_AUTOPILOT_GENERIC,
    own_mode="GUIDED",
    modes={},
    packed=False,
    bytewise=False,
    stream_first=True,
    attitude_only=True,
    integrates=False,
    rates=Rates.ALL,
    parameters=(),
)
ROS = GENERIC._replace(
    name="ros",
    number=mavlink.MAV_AUTOPILOT_RESERVED,  # no autopilot has it
    modes={(0, 0): "HOLD", (1, 0): "GUIDED", (2, 0): "LAND", (3, 0): "RTL", (4, 0): "TAKEOFF", (5, 0): "MANUAL"},
    attitude_only=False,
    land_s=1.5,  # nobody knows what it does alone
)  # fmt: skip
"""A vehicle behind topics and services of ROS 2, as its link tells of it in the words of MAVLink."""
AUTOPILOTS: Mapping[str, Autopilot] = {a.name: a for a in (PX4, ARDUPILOT, GENERIC, ROS)} | {
    "ros_take_off": ROS._replace(stream_first=False)  # has a service for it
}


def limits(values: Mapping[str, float]) -> SetpointLimits:
    """The limits of the vehicle from its parameters, for any autopilot."""

    def lowest(*names: str) -> float:
        return min(
            (values[name] for name in names if values.get(name, 0.0) > 0.0), default=math.inf
        )

    return SetpointLimits(
        lowest("MPC_XY_VEL_MAX", "WP_SPD"),
        lowest("MPC_Z_VEL_MAX_UP", "WP_SPD_UP"),
        lowest("MPC_Z_VEL_MAX_DN", "WP_SPD_DN"),
        lowest("MPC_ACC_HOR_MAX", "WP_ACC"),
        lowest("MPC_TILTMAX_AIR", "ATC_ANGLE_MAX") * _DEGREE,
    )


_PX4_WITHOUT_SETPOINTS = (  # by COM_OBL_RC_ACT
    *["needs a remote control, and sinks and drifts without one"] * 3,
    "returns and lands",
    "lands",
    "hovers until somebody lands it or its battery is low",
    *["stops its motors"] * 2,
)


_RETURN_HEIGHTS = ("RTL_RETURN_ALT", "RTL_ALT_M")  # of PX4, of ArduCopter


def fate(autopilot: Autopilot, mode: FlightMode, values: Mapping[str, float]) -> str:
    """The words for how an armed vehicle goes on without its companion, by its mode and parameters."""
    if mode is FlightMode.LAND:
        return "it lands by itself"
    if mode is FlightMode.RETURN:
        heights = [f"{name}={values[name]:g} m" for name in _RETURN_HEIGHTS if name in values]
        return " at ".join(["it returns by itself", *heights])
    if mode in (FlightMode.HOLD, FlightMode.TAKEOFF):
        return "it hovers until somebody lands it or its battery is low"
    if mode is FlightMode.OTHER:
        return "its pilot flies it"
    if autopilot is PX4:
        action = int(values.get("COM_OBL_RC_ACT", -1.0))
        if 0 <= action < len(_PX4_WITHOUT_SETPOINTS):
            known = _PX4_WITHOUT_SETPOINTS[action]
            return f"without setpoints it {known} (COM_OBL_RC_ACT={action})"
        return "without setpoints it acts as COM_OBL_RC_ACT says"
    if autopilot is ARDUPILOT:
        return (
            f"it keeps its velocity for {values.get('GUID_TIMEOUT', 3.0):g} s (GUID_TIMEOUT), then hovers in GUIDED "
            "until somebody lands it or its battery is low"
        )
    if autopilot.number == ROS.number:
        return "only its driver knows what it does without setpoints"
    return "its own failsafe acts"


def advice(values: Mapping[str, float], rate_hz: float) -> Iterator[str]:
    """Recommended changes of parameters, one line each."""
    if values.get("COM_OBL_RC_ACT") == 0.0:
        yield "COM_OBL_RC_ACT=0: without a remote control the vehicle sinks and drifts when setpoints stop; 5 is Hold"
    if values.get("COM_OF_LOSS_T", 1.0) * rate_hz < 5.0:
        yield f"COM_OF_LOSS_T={values['COM_OF_LOSS_T']:g} s: fewer than 5 setpoints at {rate_hz:g} Hz"
    if values.get("NAV_DLL_ACT", 0.0) > 0.0:
        yield f"NAV_DLL_ACT={values['NAV_DLL_ACT']:g}: a ground station must be connected, this bridge is not one"
    if values.get("GUID_TIMEOUT", 3.0) > 3.0:
        yield f"GUID_TIMEOUT={values['GUID_TIMEOUT']:g} s: the vehicle keeps the last velocity for that time"
    if values.get("FS_GCS_ENABLE", 0.0) > 0.0:
        yield f"FS_GCS_ENABLE={values['FS_GCS_ENABLE']:g}: a ground station must be connected, this bridge is not one"


def refusal(autopilot: Autopilot, values: Mapping[str, float], setpoint: str) -> str | None:
    """The reason why the vehicle cannot follow this type of setpoint; None when it can."""
    if autopilot.attitude_only and setpoint != "attitude":
        return f"{autopilot.name}: takes attitude targets only: expected mavlink.setpoint: attitude"
    options = int(values.get("GUID_OPTIONS", 0))
    if autopilot is ARDUPILOT and setpoint == "attitude" and not options & _THRUST_AS_THRUST:
        return (
            f"GUID_OPTIONS={options}: thrust would be taken for a climb rate: expected bit 3 set, "
            f"GUID_OPTIONS={options | _THRUST_AS_THRUST}, for mavlink.setpoint: attitude"
        )
    return None


def findings(autopilot: Autopilot, values: Mapping[str, float], rate_hz: float) -> Iterator[str]:
    """The lines of the log about the parameters that were read."""
    for name, value in values.items():
        yield f"{name} = {value:g}"
    if missing := [name for name in autopilot.parameters if current_name(name)[0] not in values]:
        yield f"not answered: {' '.join(missing)}"
    for line in advice(values, rate_hz):
        yield f"warning: {line}"


_RATE_LOOP_S = 0.06  # of the rates and the motors
_PX4_TILT = 0.65  # lag of the tilt times MC_ROLL_P, as measured
_ARDUPILOT_TILT_S = 0.167  # behind the shaped tilt, as measured


class VelocityResponse(NamedTuple):
    """The horizontal velocity loop of a vehicle, around its tilt.

    ArduCopter shapes the velocity before it, and follows the shaped path by position too. docs/autopilot.md has what
    was measured.
    """

    gain: float  # [1/s] proportional
    integral: float  # [1/s^2]
    derivative: float
    position_gain: float  # [1/s]; 0: no position loop around it
    shaping_1_s: float | None  # first order before the loop; None: none
    tilt_s: tuple[float, float]  # the two lags between the acceleration asked for and flown

    @property
    def tilt_lag_s(self) -> float:
        """Sum of the lags between the acceleration asked for and flown."""
        return sum(self.tilt_s)

    def measured(self, gain: float | None, tilt_lag_s: float | None) -> VelocityResponse:
        """The same with a proportional gain, and lags of this sum in the same proportion, as they were measured."""
        share = 1.0 if tilt_lag_s is None else tilt_lag_s / self.tilt_lag_s
        first_s, second_s = self.tilt_s
        return self._replace(
            gain=self.gain if gain is None else gain, tilt_s=(share * first_s, share * second_s)
        )


def velocity_response(autopilot: Autopilot, values: Mapping[str, float]) -> VelocityResponse | None:
    """The response by the parameters that were read; None where one of them is missing or makes no sense."""
    try:
        if autopilot is PX4:
            gain, integral, derivative = (values[f"MPC_XY_VEL_{part}_ACC"] for part in "PID")
            tilt_s = (_PX4_TILT / values["MC_ROLL_P"], _RATE_LOOP_S)
            response = VelocityResponse(gain, integral, derivative, 0.0, None, tilt_s)
        elif autopilot is ARDUPILOT:
            gain, integral, derivative = (values[f"PSC_NE_VEL_{part}"] for part in "PID")
            position_gain, jerk = values["PSC_NE_POS_P"], values["PSC_JERK_NE"] / values["WP_ACC"]
            tilt_s = (values["ATC_INPUT_TC"], _ARDUPILOT_TILT_S + _RATE_LOOP_S)
            response = VelocityResponse(gain, integral, derivative, position_gain, jerk, tilt_s)
        else:
            return None
    except (KeyError, ZeroDivisionError):
        return None
    sensible = response.gain > 0.0 and min(*response[:4], *response.tilt_s) >= 0.0
    return response if sensible else None
