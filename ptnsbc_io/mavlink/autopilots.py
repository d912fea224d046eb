"""The differences between autopilots: modes, parameters, encodings, and the order of commands.

PX4: docs.px4.io, Offboard Mode and Parameter Reference. ArduCopter: ardupilot.org, Copter Commands
in Guided Mode and Complete Parameter List; 4.7 renamed WPNAV_* (centimetres) to WP_* (metres).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum
from typing import NamedTuple

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.parameters import Encoding

_CENTI = 0.01
_DEGREE = 0.017453292519943295
_THRUST_AS_THRUST = 8  # bit 3 of GUID_OPTIONS


class FlightMode(Enum):
    """A flight mode, as far as the bridge distinguishes them."""

    OWN = "own"  # OFFBOARD, GUIDED: it follows setpoints
    HOLD = "hold"  # holds its position
    LAND = "land"
    RETURN = "return"
    TAKEOFF = "takeoff"
    OTHER = "other"  # for example flown by a pilot


class ModeNumbers(NamedTuple):
    """`param2` and `param3` of MAV_CMD_DO_SET_MODE."""

    main: int
    sub: int


class AutopilotLimits(NamedTuple):
    """Limits of the vehicle; None where they are not known."""

    horizontal_m_s: float | None
    up_m_s: float | None
    down_m_s: float | None
    acceleration_m_s2: float | None
    tilt_rad: float | None


class Rates(Enum):
    """The body rates that an autopilot uses beside an attitude."""

    ALL = "all"
    HEADING = "heading"  # the yaw rate alone, about the vertical
    HEADING_BY_ALL = "heading by all"  # all three or none; the frame depends on the version


class Autopilot(NamedTuple):
    """One kind of autopilot."""

    name: str
    number: int  # MAV_AUTOPILOT
    own_mode: str  # name of the mode that follows setpoints
    modes: Mapping[ModeNumbers, FlightMode]
    packed: bool  # custom_mode holds main in its third byte and sub in its fourth
    encoding: Encoding
    earth_radius_m: float  # of its local projection
    stream_first: bool  # the mode needs setpoints before and during
    climbs: bool  # takes off by a setpoint; otherwise by NAV_TAKEOFF
    attitude_only: bool
    rates: Rates
    parameters: tuple[str, ...]

    def mode(self, base_mode: int, custom_mode: int) -> FlightMode:
        """The mode in a HEARTBEAT."""
        if self.attitude_only:
            guided = base_mode & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            return (
                FlightMode.OWN
                if guided
                else self.modes.get(ModeNumbers(custom_mode, 0), FlightMode.OTHER)
            )
        if self.packed:
            numbers = ModeNumbers(custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
        else:
            numbers = ModeNumbers(custom_mode, 0)
        return self.modes.get(numbers, FlightMode.OTHER)

    def mode_numbers(self, mode: FlightMode) -> ModeNumbers:
        """The numbers with which to request a mode."""
        return next(numbers for numbers, known in self.modes.items() if known is mode)


_SHAPING = (
    ("PSC_NE_POS_P", "PSC_POSXY_P"),
    ("PSC_NE_VEL_P", "PSC_VELXY_P"),
    ("PSC_NE_VEL_I", "PSC_VELXY_I"),
    ("PSC_NE_VEL_D", "PSC_VELXY_D"),
    ("PSC_JERK_NE", "PSC_JERK_XY"),
)
_PX4_AUTO = 4
PX4 = Autopilot(
    name="px4",
    number=mavlink.MAV_AUTOPILOT_PX4,
    own_mode="OFFBOARD",
    modes={
        ModeNumbers(6, 0): FlightMode.OWN,
        ModeNumbers(_PX4_AUTO, 3): FlightMode.HOLD,
        ModeNumbers(_PX4_AUTO, 6): FlightMode.LAND,
        ModeNumbers(_PX4_AUTO, 9): FlightMode.LAND,  # precision landing
        ModeNumbers(_PX4_AUTO, 5): FlightMode.RETURN,
        ModeNumbers(_PX4_AUTO, 2): FlightMode.TAKEOFF,
    },
    packed=True,
    encoding=Encoding.BYTEWISE,
    earth_radius_m=6371000.0,
    stream_first=True,
    climbs=True,
    attitude_only=False,
    rates=Rates.HEADING,
    parameters=(
        "COM_OF_LOSS_T",
        "COM_OBL_RC_ACT",
        "COM_RCL_EXCEPT",
        "NAV_DLL_ACT",
        "COM_DISARM_PRFLT",
        "MPC_XY_VEL_MAX",
        "MPC_Z_VEL_MAX_UP",
        "MPC_Z_VEL_MAX_DN",
        "MPC_ACC_HOR_MAX",
        "MPC_ACC_UP_MAX",
        "MPC_TILTMAX_AIR",
        "MPC_THR_HOVER",
        "MPC_XY_VEL_P_ACC",
        "MPC_XY_VEL_I_ACC",
        "MPC_XY_VEL_D_ACC",
        "MC_ROLL_P",
    ),
)
ARDUPILOT = Autopilot(
    name="ardupilot",
    number=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    own_mode="GUIDED",
    modes={
        ModeNumbers(4, 0): FlightMode.OWN,
        ModeNumbers(17, 0): FlightMode.HOLD,  # BRAKE
        ModeNumbers(9, 0): FlightMode.LAND,
        ModeNumbers(6, 0): FlightMode.RETURN,
        ModeNumbers(21, 0): FlightMode.RETURN,  # SMART_RTL
    },
    packed=False,
    encoding=Encoding.C_CAST,
    earth_radius_m=6378100.0,
    stream_first=False,
    climbs=False,
    attitude_only=False,
    rates=Rates.HEADING_BY_ALL,
    parameters=(
        "GUID_TIMEOUT",
        "GUID_OPTIONS",
        "WP_SPD",
        "WP_SPD_UP",
        "WP_SPD_DN",
        "WP_ACC",
        "WPNAV_SPEED",
        "WPNAV_SPEED_UP",
        "WPNAV_SPEED_DN",
        "WPNAV_ACCEL",
        "ATC_ANGLE_MAX",
        "ANGLE_MAX",
        "MOT_THST_HOVER",
        "FS_EKF_ACTION",
        "FS_GCS_ENABLE",
        "BATT_FS_LOW_ACT",
        "ATC_INPUT_TC",
        *(name for names in _SHAPING for name in names),
    ),
)
GENERIC = Autopilot(
    name="generic",
    number=mavlink.MAV_AUTOPILOT_GENERIC,
    own_mode="GUIDED",
    modes={},
    packed=False,
    encoding=Encoding.C_CAST,
    earth_radius_m=6371000.0,
    stream_first=True,
    climbs=True,
    attitude_only=True,
    rates=Rates.ALL,
    parameters=(),
)
AUTOPILOTS: Mapping[str, Autopilot] = {a.name: a for a in (PX4, ARDUPILOT, GENERIC)}

_ALTERNATIVES = (
    ("WP_SPD", "WPNAV_SPEED"),
    ("WP_SPD_UP", "WPNAV_SPEED_UP"),
    ("WP_SPD_DN", "WPNAV_SPEED_DN"),
    ("WP_ACC", "WPNAV_ACCEL"),
    ("ATC_ANGLE_MAX", "ANGLE_MAX"),
    *_SHAPING,
)


def missing_parameters(autopilot: Autopilot, values: Mapping[str, float]) -> list[str]:
    """Expected parameters without an answer; of an old and a new name one is enough."""
    missing = [name for name in autopilot.parameters if name not in values]
    for names in _ALTERNATIVES:
        if any(name in values for name in names):
            missing = [name for name in missing if name not in names]
    return missing


def limits(values: Mapping[str, float]) -> AutopilotLimits:
    """The limits of the vehicle from its parameters, for any autopilot."""

    def lowest(*found: float | None) -> float | None:
        return min((value for value in found if value is not None and value > 0.0), default=None)

    def centi(name: str) -> float | None:
        return values[name] * _CENTI if name in values else None

    get = values.get
    tilt_deg = lowest(get("MPC_TILTMAX_AIR"), get("ATC_ANGLE_MAX"), centi("ANGLE_MAX"))
    return AutopilotLimits(
        lowest(get("MPC_XY_VEL_MAX"), get("WP_SPD"), centi("WPNAV_SPEED")),
        lowest(get("MPC_Z_VEL_MAX_UP"), get("WP_SPD_UP"), centi("WPNAV_SPEED_UP")),
        lowest(get("MPC_Z_VEL_MAX_DN"), get("WP_SPD_DN"), centi("WPNAV_SPEED_DN")),
        lowest(get("MPC_ACC_HOR_MAX"), get("WP_ACC"), centi("WPNAV_ACCEL")),
        None if tilt_deg is None else tilt_deg * _DEGREE,
    )


_PX4_WITHOUT_SETPOINTS: Mapping[int, str] = {
    0: "needs a remote control (COM_OBL_RC_ACT=0), and sinks and drifts without one",
    1: "needs a remote control (COM_OBL_RC_ACT=1), and sinks and drifts without one",
    2: "needs a remote control (COM_OBL_RC_ACT=2), and sinks and drifts without one",
    3: "returns and lands (COM_OBL_RC_ACT=3)",
    4: "lands (COM_OBL_RC_ACT=4)",
    5: "hovers until somebody lands it or its battery is low (COM_OBL_RC_ACT=5)",
    6: "stops its motors (COM_OBL_RC_ACT=6)",
    7: "stops its motors (COM_OBL_RC_ACT=7)",
}


def fate(autopilot: Autopilot, mode: FlightMode, values: Mapping[str, float]) -> str:
    """The words for how an armed vehicle goes on without its companion, by its mode and parameters."""
    if mode is FlightMode.LAND:
        return "it lands by itself"
    if mode is FlightMode.RETURN:
        return "it returns by itself"
    if mode in (FlightMode.HOLD, FlightMode.TAKEOFF):
        return "it hovers until somebody lands it or its battery is low"
    if mode is FlightMode.OTHER:
        return "its pilot flies it"
    if autopilot is PX4:
        action = values.get("COM_OBL_RC_ACT")
        known = None if action is None else _PX4_WITHOUT_SETPOINTS.get(int(action))
        return f"without setpoints it {known or 'acts as COM_OBL_RC_ACT says'}"
    if autopilot is ARDUPILOT:
        return (
            f"it keeps its velocity for {values.get('GUID_TIMEOUT', 3.0):g} s (GUID_TIMEOUT), then hovers in GUIDED "
            "until somebody lands it or its battery is low"
        )
    return "its own failsafe acts"


def hover_thrust(values: Mapping[str, float]) -> float | None:
    """Normalised thrust at hover, where the vehicle has a parameter for it."""
    return values.get("MPC_THR_HOVER", values.get("MOT_THST_HOVER"))


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
    missing = missing_parameters(autopilot, values)
    if missing:
        yield f"not answered: {' '.join(missing)}"
    for line in advice(values, rate_hz):
        yield f"warning: {line}"
