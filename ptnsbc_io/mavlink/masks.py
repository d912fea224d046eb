"""Type masks of setpoint messages, by the names of the fields that are used.

MAVLink's masks list the fields to ignore; written as numbers they are a classic cause of flyaways.
Here a caller names the fields that it fills in, and all others are ignored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.dialect import mavlink

_POSITION_TARGET: Mapping[str, int] = {
    "x": mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE,
    "y": mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE,
    "z": mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE,
    "vx": mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE,
    "vy": mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE,
    "vz": mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE,
    "afx": mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE,
    "afy": mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE,
    "afz": mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE,
    "yaw": mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE,
    "yaw_rate": mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE,
}
_ATTITUDE_TARGET: Mapping[str, int] = {
    "q": mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE,
    "body_roll_rate": mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE,
    "body_pitch_rate": mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE,
    "body_yaw_rate": mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE,
    "thrust": mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE,
}

POSITION = ("x", "y", "z")
VELOCITY = ("vx", "vy", "vz")
ACCELERATION = ("afx", "afy", "afz")
RATES = ("body_roll_rate", "body_pitch_rate", "body_yaw_rate")


class MaskError(PtnsbcError):
    """A setpoint names a field that the message does not have, or no field."""


def position_target(used: Iterable[str]) -> int:
    """Mask of SET_POSITION_TARGET_LOCAL_NED that uses the fields `used`."""
    return _mask(used, _POSITION_TARGET, "SET_POSITION_TARGET_LOCAL_NED")


def attitude_target(used: Iterable[str]) -> int:
    """Mask of SET_ATTITUDE_TARGET that uses the fields `used`."""
    return _mask(used, _ATTITUDE_TARGET, "SET_ATTITUDE_TARGET")


def _mask(used: Iterable[str], bits: Mapping[str, int], message: str) -> int:
    wanted = set(used)
    unknown = wanted - bits.keys()
    if unknown or not wanted:
        # PX4 drops a setpoint in which everything is ignored, without an answer.
        what = ", ".join(sorted(unknown)) or "no field at all"
        raise MaskError(f"{message}: {what}: expected some of {', '.join(bits)}")
    mask = 0
    for name, bit in bits.items():
        mask |= 0 if name in wanted else bit
    return mask
