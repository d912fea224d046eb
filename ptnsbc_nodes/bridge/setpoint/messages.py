"""Setpoint messages from quantities in our frames; the fields that count are named, not numbered."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames, masks
from ptnsbc_io.mavlink.autopilots import Autopilot, Rates
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT
from ptnsbc_nodes.bridge.setpoint.attitude import AttitudeTarget
from ptnsbc_nodes.bridge.setpoint.body_rates import about_vertical

_PLACE = masks.position_target((*masks.POSITION, "yaw"))
_VELOCITY = masks.position_target((*masks.VELOCITY, "yaw"))
_VELOCITY_PUSHED = masks.position_target((*masks.VELOCITY, *masks.ACCELERATION, "yaw"))
_BOTH = masks.position_target((*masks.POSITION, *masks.VELOCITY, "yaw"))
_BOTH_PUSHED = masks.position_target((*masks.POSITION, *masks.VELOCITY, *masks.ACCELERATION, "yaw"))
_ATTITUDE = {
    # PX4 gives roll and pitch rates beside an attitude to nobody, and takes the yaw rate about the vertical.
    Rates.HEADING: masks.attitude_target(("q", "thrust", "body_yaw_rate")),
    # ArduCopter drops a target with some of the three, and its versions turn them into the world or do not.
    Rates.HEADING_BY_ALL: masks.attitude_target(("q", "thrust", *masks.RATES)),
    Rates.ALL: masks.attitude_target(("q", "thrust", *masks.RATES)),
}
_NOTHING = np.zeros(3)
_32_BITS = 0xFFFFFFFF


class Setpoints:
    """Messages for one vehicle, positions relative to its own local origin."""

    def __init__(self, autopilot: Autopilot, sysid: int) -> None:
        self._sysid = sysid
        self._rates = autopilot.rates

    def place(self, now_s: float, local_enu: Array, yaw_enu: float) -> Any:
        """Stay at a point (3,) [m] of the local frame."""
        return self._position_target(now_s, _PLACE, (local_enu, _NOTHING, _NOTHING), yaw_enu)

    def velocity(self, now_s: float, velocity_enu: Array, push: Array | None, yaw: float) -> Any:
        """Fly at a velocity (3,) [m/s]; `push`: acceleration feed-forward (3,) [m/s^2] or None."""
        mask = _VELOCITY if push is None else _VELOCITY_PUSHED
        pushed = _NOTHING if push is None else push
        return self._position_target(now_s, mask, (_NOTHING, velocity_enu, pushed), yaw)

    def both(
        self, now_s: float, local_enu: Array, velocity_enu: Array, push: Array | None, yaw: float
    ) -> Any:
        """Pass a point at a velocity."""
        mask = _BOTH if push is None else _BOTH_PUSHED
        pushed = _NOTHING if push is None else push
        return self._position_target(now_s, mask, (local_enu, velocity_enu, pushed), yaw)

    def attitude(self, now_s: float, target: AttitudeTarget) -> Any:
        """Point, turn and pull."""
        return mavlink.MAVLink_set_attitude_target_message(
            _milliseconds(now_s),
            self._sysid,
            AUTOPILOT_COMPONENT,
            _ATTITUDE[self._rates],
            frames.quaternion_enu_flu_to_ned_frd(target.quaternion).tolist(),
            *frames.vector_flu_to_frd(self._understood(target)).tolist(),
            target.thrust,
        )

    def _understood(self, target: AttitudeTarget) -> Array:
        """The rates (3,) of a target as this autopilot reads them [rad/s, FLU]."""
        if self._rates is Rates.ALL:
            return target.rates
        turn = about_vertical(target.rates, target.quaternion)
        if self._rates is Rates.HEADING:
            return np.array([0.0, 0.0, turn])
        # A rotation about the vertical is the same in the world, and nearly so in a body that is not far from level.
        return turn * rotation_from_quaternion(target.quaternion)[2]

    def _position_target(
        self, now_s: float, mask: int, vectors_enu: tuple[Array, Array, Array], yaw_enu: float
    ) -> Any:
        numbers = [
            float(number) for vector in vectors_enu for number in frames.vector_enu_to_ned(vector)
        ]
        return mavlink.MAVLink_set_position_target_local_ned_message(
            _milliseconds(now_s),
            self._sysid,
            AUTOPILOT_COMPONENT,
            mavlink.MAV_FRAME_LOCAL_NED,
            mask,
            *numbers,
            frames.yaw_enu_to_ned(yaw_enu),
            0.0,
        )


def _milliseconds(now_s: float) -> int:
    return round(now_s * 1e3) & _32_BITS
