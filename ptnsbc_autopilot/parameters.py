"""Parameters as autopilots send them: PX4 puts the raw bits of an integer into the float, ArduPilot its value.

https://mavlink.io/en/services/parameter.html, "Parameter Encoding".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ptnsbc_io.mavlink.dialect import mavlink

Value = int | float


class ParamValueFields(NamedTuple):
    """A parameter as the fields of PARAM_VALUE after its name."""

    value: float
    type: int
    param_count: int
    param_index: int


class AutopilotParameters:
    """Named values; an `int` is an INT32, a `float` a REAL32. The order is that of the index."""

    def __init__(self, values: Mapping[str, Value], *, bytewise: bool) -> None:
        self._values: dict[str, Value] = dict(sorted(values.items()))
        self._names = list(self._values)
        self._bytewise = bytewise

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def name_at(self, index: int) -> str | None:
        """Name by index, None beyond the last."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def put(self, name: str, value: Value) -> None:
        """Set a known parameter, keeping its type."""
        kind = int if isinstance(self._values[name], int) else float
        self._values[name] = kind(value)

    def encoded(self, name: str) -> ParamValueFields:
        """One parameter for the wire."""
        value = self._values[name]
        whole = isinstance(value, int)
        kind = mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32
        sent = _bits_as_float(int(value)) if whole and self._bytewise else float(value)
        return ParamValueFields(sent, kind, len(self._names), self._names.index(name))

    def decoded(self, name: str, sent: float, kind: int) -> Value | None:
        """Value of a PARAM_SET; None when PX4 refuses its type; ArduPilot accepts any type."""
        whole = isinstance(self._values[name], int)
        if not self._bytewise:
            return round(sent) if whole else sent
        if whole != (kind == mavlink.MAV_PARAM_TYPE_INT32):
            return None
        return _float_as_bits(sent) if whole else sent


def _bits_as_float(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def _float_as_bits(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


PX4: Mapping[str, Value] = {
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3,
    "COM_SPOOLUP_TIME": 1.0,
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MC_PITCH_P": 6.5,
    "MC_ROLL_P": 6.5,
    "MC_YAW_P": 2.8,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_ACC_HOR_MAX": 5.0,
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_THR_HOVER": 0.5,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAWRAUTO_MAX": 60.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RTL_RETURN_ALT": 60.0,
    "SYS_AUTOSTART": 4001,
}
"""https://docs.px4.io/main/en/advanced_config/parameter_reference, the defaults of a quadrotor."""

ARDUCOPTER: Mapping[str, Value] = {
    "ARMING_CHECK": 1,
    "ATC_ANGLE_MAX": 30.0,
    "ATC_INPUT_TC": 0.15,
    "BATT_FS_CRT_ACT": 0,
    "BATT_FS_LOW_ACT": 0,
    "DISARM_DELAY": 10,
    "FS_EKF_ACTION": 1,
    "FRAME_CLASS": 1,
    "FS_GCS_ENABLE": 0,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "LAND_SPD_MS": 0.5,
    "MAV_SYSID": 1,
    "MOT_THST_HOVER": 0.35,
    "PSC_JERK_D": 5.0,
    "PSC_JERK_NE": 5.0,
    "PSC_NE_POS_P": 1.0,
    "PSC_NE_VEL_D": 0.5,
    "PSC_NE_VEL_FLTE": 5.0,
    "PSC_NE_VEL_I": 1.0,
    "PSC_NE_VEL_P": 2.0,
    "RTL_ALT_M": 15.0,
    "WP_ACC": 2.5,
    "WP_ACC_Z": 1.0,
    "WP_SPD": 10.0,
    "WP_SPD_DN": 1.5,
    "WP_SPD_UP": 2.5,
}
"""Names and units of Copter 4.7, which renamed WPNAV_SPEED [cm/s] to WP_SPD [m/s].

https://ardupilot.org/copter/docs/parameters.html
"""

STM32: Mapping[str, Value] = {
    "ATT_TIMEOUT_S": 0.5,
    "BATT_LIFE_S": 1500.0,
    "DISARM_LAND_S": 2.0,
    "MAX_TILT_RAD": 0.7,
    "THR_CURVE": 1.0,
    "THR_DELAY_S": 0.0,
    "THR_SAG": 0.0,
}
"""Of the controller that takes attitude targets only; ours."""
