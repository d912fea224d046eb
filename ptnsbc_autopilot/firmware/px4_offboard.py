"""PX4's offboard setpoints, and its thrust ramp at take-off."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_autopilot.firmware import setpoints
from ptnsbc_autopilot.physics import airframe, targets
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

LIFT_SHARE_OF_RAMP = 2.5 / 3.0
"""Share of MPC_TKO_RAMP_T until the vehicle lifts off. Measured: first motion about 2.5 s after a climb command."""

_UNIT_TOLERANCE = 0.1


class OffboardSetpoint(NamedTuple):
    """A setpoint that PX4 accepts."""

    target: Array  # (22,)
    climbs: bool  # whether it leads off the ground


def read_position_target(
    message: Any, heading_ned_rad: float, height_m: float
) -> OffboardSetpoint | str:
    """The setpoint in a SET_POSITION_TARGET_LOCAL_NED, or the text with which PX4 refuses it.

    PX4 takes LOCAL_NED and BODY_NED, no forces, and at least one number. In BODY_NED it ignores the position.
    """
    wanted = setpoints.read_position_target(message)
    name = "SET_POSITION_TARGET_LOCAL_NED"
    if wanted.frame == mavlink.MAV_FRAME_BODY_NED:
        none = np.full(3, math.nan)
        wanted = setpoints.heading_to_ned(wanted._replace(position_ned=none), heading_ned_rad)
    elif wanted.frame != mavlink.MAV_FRAME_LOCAL_NED:
        return f"{name} coordinate frame {wanted.frame} unsupported"
    acceleration = wanted.acceleration_ned
    if wanted.force and np.isfinite(acceleration).any():
        return f"{name} force not supported"
    if not np.isfinite((wanted.position_ned, wanted.velocity_ned, acceleration)).any():
        return f"{name} invalid"
    higher = wanted.position_ned[2] < -height_m
    climbs = bool(higher or wanted.velocity_ned[2] < 0.0 or acceleration[2] < 0.0)
    return OffboardSetpoint(setpoints.position_airframe_target(wanted), climbs)


def read_attitude(message: Any) -> OffboardSetpoint | None:
    """The setpoint in a SET_ATTITUDE_TARGET with attitude or all body rates, and a thrust; else None.

    Beside an attitude PX4 takes the yaw rate only, as a feed-forward about the vertical.
    """
    wanted = setpoints.read_attitude(message)
    rates = bool(np.isfinite(wanted.rates_frd).all())
    if not math.isfinite(wanted.thrust) or (wanted.attitude_ned is None and not rates):
        return None
    if wanted.attitude_ned is not None and not setpoints.is_unit(
        wanted.attitude_ned, _UNIT_TOLERANCE
    ):
        return None
    if wanted.attitude_ned is not None:
        turn = wanted.rates_frd[2] * setpoints.down_in_body(wanted.attitude_ned)
        wanted = wanted._replace(rates_frd=turn)
    return OffboardSetpoint(setpoints.attitude_airframe_target(wanted), False)


class OffboardStream:
    """The latest setpoint, and since when setpoints arrive."""

    def __init__(self) -> None:
        self.setpoint = OffboardSetpoint(targets.IDLE_TARGET, False)
        self._latest_t = self._since_t = -math.inf

    def take(self, wanted: OffboardSetpoint, t: float, loss_s: float) -> None:
        """Take a setpoint at t [s]; after a gap of more than `loss_s` a new stream begins."""
        if not self.fresh(t, loss_s):
            self._since_t = t
        self.setpoint, self._latest_t = wanted, t

    def fresh(self, t: float, loss_s: float) -> bool:
        """True if the latest setpoint is at most `loss_s` old."""
        return t - self._latest_t <= loss_s

    def streamed_s(self, t: float) -> float:
        """The time for which setpoints have arrived."""
        return t - self._since_t

    @property
    def needs_position(self) -> bool:
        """True if the setpoint needs a valid position."""
        return bool(self.setpoint.target[airframe.KIND] == airframe.TRAJECTORY)


class TakeoffRamp:
    """Take-off: the thrust is limited, and the limit rises from the first climb setpoint on."""

    def __init__(self) -> None:
        self.flying = False
        self._ramp_t: float | None = None

    def update(self, in_contact: bool, landed: bool) -> bool:
        """Update by the ground contact; True at the moment of landing."""
        if not in_contact:
            self.flying = True
        elif self.flying and landed:
            self.flying, self._ramp_t = False, None
            return True
        return False

    def target(
        self, target: Array, climb: bool, hover_share: float, lift_s: float, t: float
    ) -> Array:
        """Idle, or the target with a thrust limit that reaches the weight `lift_s` after the first climb setpoint."""
        if not climb:
            self._ramp_t = None
            return targets.IDLE_TARGET
        if self._ramp_t is None:
            self._ramp_t = t
        capped = target.copy()
        capped[airframe.THRUST_CAP] = hover_share * (t - self._ramp_t) / max(lift_s, 1e-3)
        return capped
