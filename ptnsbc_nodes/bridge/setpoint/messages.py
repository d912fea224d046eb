"""Setpoint messages from quantities in ENU and FLU; the fields that count are named, not numbered."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames, masks
from ptnsbc_io.mavlink.autopilots import Autopilot, Rates
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT
from ptnsbc_nodes.bridge.setpoint.attitude import AttitudeTarget, vertical_rate

_FIELDS = (masks.POSITION, masks.VELOCITY, masks.ACCELERATION)
_ATTITUDE = {
    # PX4 ignores roll and pitch rates beside an attitude, and takes the yaw rate about the vertical.
    Rates.HEADING: masks.attitude_target(("q", "thrust", "body_yaw_rate")),
    # ArduCopter drops a target that has only some of the three rates. Some of its versions turn the rates
    # into the world frame, and some do not.
    Rates.HEADING_BY_ALL: masks.attitude_target(("q", "thrust", *masks.RATES)),
    Rates.ALL: masks.attitude_target(("q", "thrust", *masks.RATES)),
}
_ZERO = np.zeros(3)
_32_BITS = 0xFFFFFFFF


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
        numbers = (
            number
            for vector in vectors
            for number in frames.vector_enu_to_ned(_ZERO if vector is None else vector)
        )
        return mavlink.MAVLink_set_position_target_local_ned_message(
            _milliseconds(now_s),
            self._sysid,
            AUTOPILOT_COMPONENT,
            mavlink.MAV_FRAME_LOCAL_NED,
            _position_mask(*(vector is not None for vector in vectors)),
            *map(float, numbers),
            frames.yaw_enu_to_ned(yaw_enu),
            0.0,
        )

    def attitude(self, now_s: float, target: AttitudeTarget) -> Any:
        """SET_ATTITUDE_TARGET."""
        return mavlink.MAVLink_set_attitude_target_message(
            _milliseconds(now_s),
            self._sysid,
            AUTOPILOT_COMPONENT,
            _ATTITUDE[self._rates],
            frames.quaternion_enu_flu_to_ned_frd(target.quaternion).tolist(),
            *frames.vector_flu_to_frd(self._autopilot_rates(target)).tolist(),
            target.thrust,
        )

    def _autopilot_rates(self, target: AttitudeTarget) -> Array:
        """The rates (3,) of a target as this autopilot reads them [rad/s, FLU]."""
        if self._rates is Rates.ALL:
            return target.rates
        turn = vertical_rate(target.rates, target.quaternion)
        if self._rates is Rates.HEADING:
            return np.array([0.0, 0.0, turn])
        # A rotation about the vertical is the same in the world frame, and nearly the same in a body near level.
        return turn * rotation_from_quaternion(target.quaternion)[2]


@cache
def _position_mask(*given: bool) -> int:
    used = [name for names, one in zip(_FIELDS, given, strict=True) if one for name in names]
    return masks.position_target((*used, "yaw"))


def _milliseconds(now_s: float) -> int:
    return round(now_s * 1e3) & _32_BITS
