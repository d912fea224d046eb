"""Setpoint messages from quantities in ENU and FLU; the fields that count are named, not numbered.

MAVLink's masks list the fields to ignore; written as numbers they are a classic cause of flyaways. Here a caller names
the fields that it fills in, and all others are ignored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import Autopilot, Rates
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT

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
_32_BITS = 0xFFFFFFFF


class MaskError(PtnsbcError):
    """A setpoint names a field that the message does not have, or no field."""


def position_target_mask(used: Iterable[str]) -> int:
    """Mask of SET_POSITION_TARGET_LOCAL_NED that uses the fields `used`."""
    return _mask(used, _POSITION_TARGET, "SET_POSITION_TARGET_LOCAL_NED")


def attitude_target_mask(used: Iterable[str]) -> int:
    """Mask of SET_ATTITUDE_TARGET that uses the fields `used`."""
    return _mask(used, _ATTITUDE_TARGET, "SET_ATTITUDE_TARGET")


def _mask(used: Iterable[str], bits: Mapping[str, int], message: str) -> int:
    wanted = set(used)
    unknown = wanted - bits.keys()
    if unknown or not wanted:
        # PX4 drops a setpoint in which everything is ignored, without an answer.
        what = ", ".join(sorted(unknown)) or "no field at all"
        raise MaskError(f"{message}: {what}: expected some of {', '.join(bits)}")
    return sum(bit for name, bit in bits.items() if name not in wanted)


_ATTITUDE_MASKS = {
    # PX4 ignores roll and pitch rates beside an attitude, and takes the yaw rate about the vertical.
    Rates.HEADING: attitude_target_mask(("q", "thrust", "body_yaw_rate")),
    # ArduCopter drops a target that has only some of the three rates. Some of its versions turn the rates
    # into the world frame, and some do not.
    Rates.HEADING_BY_ALL: attitude_target_mask(("q", "thrust", *RATES)),
    Rates.ALL: attitude_target_mask(("q", "thrust", *RATES)),
}


@cache
def _position_mask(*filled: bool) -> int:
    vectors = (POSITION, VELOCITY, ACCELERATION)
    used = [name for names, use in zip(vectors, filled, strict=True) if use for name in names]
    return position_target_mask((*used, "yaw"))


class AttitudeTarget(NamedTuple):
    """The content of SET_ATTITUDE_TARGET, in ENU and FLU."""

    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s] at which the target itself turns, FLU of the target
    thrust: float  # 0 to 1


class SetpointMessages:
    """Messages for one vehicle; positions are relative to its own local origin."""

    def __init__(self, autopilot: Autopilot, sysid: int) -> None:
        self._sysid = sysid
        self._rates = autopilot.rates

    def position_target(
        self,
        now_s: float,
        yaw_enu: float,
        *,
        position: Array | None = None,
        velocity: Array | None = None,
        acceleration: Array | None = None,
    ) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED with a heading and what is given: (3,) [m, m/s, m/s^2], local ENU."""
        vectors = (position, velocity, acceleration)
        numbers: list[float] = []
        for vector in vectors:
            numbers += [0.0] * 3 if vector is None else frames.vector_enu_to_ned(vector).tolist()
        return mavlink.MAVLink_set_position_target_local_ned_message(
            round(now_s * 1e3) & _32_BITS,
            self._sysid,
            AUTOPILOT_COMPONENT,
            mavlink.MAV_FRAME_LOCAL_NED,
            _position_mask(*(vector is not None for vector in vectors)),
            *numbers,
            frames.yaw_enu_to_ned(yaw_enu),
            0.0,
        )

    def attitude_target(self, now_s: float, target: AttitudeTarget) -> Any:
        """SET_ATTITUDE_TARGET, with the rates as this autopilot reads them."""
        rates = target.rates
        if self._rates is not Rates.ALL:
            up = rotation_from_quaternion(target.quaternion)[2]
            turn = float(up @ rates)  # about the vertical, positive to the left
            # Such a turn is the same in the world frame, and nearly the same in a body near level.
            by_heading = self._rates is Rates.HEADING
            rates = np.array([0.0, 0.0, turn]) if by_heading else turn * up
        return mavlink.MAVLink_set_attitude_target_message(
            round(now_s * 1e3) & _32_BITS,
            self._sysid,
            AUTOPILOT_COMPONENT,
            _ATTITUDE_MASKS[self._rates],
            frames.quaternion_enu_flu_to_ned_frd(target.quaternion).tolist(),
            *frames.vector_flu_to_frd(rates).tolist(),
            target.thrust,
        )
