"""Setpoint messages from quantities in ENU and FLU; what a caller leaves out, the vehicle is told to ignore."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import Autopilot, Rates
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT

# MAVLink's masks list what to ignore; written as numbers they are a classic cause of flyaways.
_IGNORE_VECTOR = tuple(
    sum(getattr(mavlink, f"POSITION_TARGET_TYPEMASK_{axis}_IGNORE") for axis in axes)
    for axes in (("X", "Y", "Z"), ("VX", "VY", "VZ"), ("AX", "AY", "AZ"))
)
"""Bits of SET_POSITION_TARGET_LOCAL_NED without position, velocity and acceleration."""
_32_BITS = 0xFFFFFFFF


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
        mask = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
        numbers: list[float] = []
        for vector, ignore in zip((position, velocity, acceleration), _IGNORE_VECTOR, strict=True):
            mask |= ignore if vector is None else 0
            numbers += [0.0] * 3 if vector is None else frames.vector_enu_to_ned(vector).tolist()
        return mavlink.MAVLink_set_position_target_local_ned_message(
            round(now_s * 1e3) & _32_BITS,
            self._sysid,
            AUTOPILOT_COMPONENT,
            mavlink.MAV_FRAME_LOCAL_NED,
            mask,
            *numbers,
            frames.yaw_enu_to_ned(yaw_enu),
            0.0,
        )

    def attitude_target(self, now_s: float, target: AttitudeTarget) -> Any:
        """SET_ATTITUDE_TARGET, with the rates as this autopilot reads them."""
        rates, mask = target.rates, 0
        up = rotation_from_quaternion(target.quaternion)[2]
        turn = float(up @ rates)  # about the vertical, positive to the left
        if self._rates is Rates.HEADING:
            mask = mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
            mask |= mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
            rates = np.array([0.0, 0.0, turn])
        elif self._rates is Rates.HEADING_BY_ALL:
            # Some versions turn the rates into the world frame: there, and in a body near level, this is the same.
            rates = turn * up
        return mavlink.MAVLink_set_attitude_target_message(
            round(now_s * 1e3) & _32_BITS,
            self._sysid,
            AUTOPILOT_COMPONENT,
            mask,
            frames.quaternion_enu_flu_to_ned_frd(target.quaternion).tolist(),
            *frames.vector_flu_to_frd(rates).tolist(),
            target.thrust,
        )
