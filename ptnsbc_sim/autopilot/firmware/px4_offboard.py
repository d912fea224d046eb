"""PX4's offboard stream and its way off the ground."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.firmware import setpoints
from ptnsbc_sim.autopilot.physics import airframe, targets

LIFT_SHARE_OF_RAMP = 2.5 / 3.0
"""When MPC_TKO_RAMP_T has lifted the vehicle. Measured: first motion about 2.5 s after a climb command."""

_UNIT_TOLERANCE = 0.1


class OffboardSetpoint(NamedTuple):
    """A setpoint that PX4 takes."""

    target: Array  # (22,)
    climbs: bool  # whether it asks to leave the ground


def read_trajectory(
    message: Any, heading_ned_rad: float, height_m: float
) -> OffboardSetpoint | str:
    """A SET_POSITION_TARGET_LOCAL_NED, or what PX4 says of it.

    LOCAL_NED and BODY_NED only, no forces, at least one number; a body frame has no position.
    """
    wanted = setpoints.trajectory(message)
    name = "SET_POSITION_TARGET_LOCAL_NED"
    if wanted.frame == mavlink.MAV_FRAME_BODY_NED:
        nowhere = np.full(3, math.nan)
        wanted = setpoints.turned(wanted._replace(position_ned=nowhere), heading_ned_rad)
    elif wanted.frame != mavlink.MAV_FRAME_LOCAL_NED:
        return f"{name} coordinate frame {wanted.frame} unsupported"
    if wanted.accelerations and wanted.force:
        return f"{name} force not supported"
    if not (wanted.positions or wanted.velocities or wanted.accelerations):
        return f"{name} invalid"
    higher = bool(wanted.position_ned[2] < -height_m)
    return OffboardSetpoint(setpoints.trajectory_target(wanted), higher or wanted.climbs)


def read_attitude(message: Any) -> OffboardSetpoint | None:
    """A SET_ATTITUDE_TARGET: attitude or all body rates, with a thrust; None for anything else.

    Of the rates beside an attitude PX4 takes only that of yaw, as a feed-forward about the vertical.
    """
    wanted = setpoints.attitude(message)
    rates = bool(np.isfinite(wanted.rates_frd).all())
    if not math.isfinite(wanted.thrust) or (wanted.attitude_ned is None and not rates):
        return None
    if wanted.attitude_ned is not None and not setpoints.unit(wanted.attitude_ned, _UNIT_TOLERANCE):
        return None
    if wanted.attitude_ned is not None:
        turn = wanted.rates_frd[2] * setpoints.down_in_body(wanted.attitude_ned)
        wanted = wanted._replace(rates_frd=turn)
    return OffboardSetpoint(setpoints.attitude_target(wanted), False)


class Offboard:
    """The latest setpoint and how long they have been coming."""

    def __init__(self) -> None:
        self._wanted = OffboardSetpoint(targets.IDLE_TARGET, False)
        self._latest_t = self._since_t = -math.inf

    def take(self, wanted: OffboardSetpoint, t: float, loss_s: float) -> None:
        """A setpoint at t [s]; after a gap of more than `loss_s` a new stream begins."""
        if not self.fresh(t, loss_s):
            self._since_t = t
        self._wanted, self._latest_t = wanted, t

    def fresh(self, t: float, loss_s: float) -> bool:
        """Whether the latest is young enough."""
        return t - self._latest_t <= loss_s

    def streamed_s(self, t: float) -> float:
        """How long they have been coming."""
        return t - self._since_t

    @property
    def target(self) -> Array:
        """The latest (22,)."""
        return self._wanted.target

    @property
    def climbs(self) -> bool:
        """Whether it asks to leave the ground."""
        return self._wanted.climbs

    @property
    def needs_position(self) -> bool:
        """Whether the position must be known to follow it."""
        return bool(self.target[airframe.KIND] == airframe.TRAJECTORY)


class LiftOff:
    """From standing to flying: thrust is capped, and the cap rises once a climb is wanted."""

    def __init__(self) -> None:
        self.flying = False
        self._ramp_t: float | None = None

    def settle(self, in_contact: bool, landed: bool) -> bool:
        """Follow the ground; True at the moment of landing."""
        if not in_contact:
            self.flying = True
        elif self.flying and landed:
            self.flying, self._ramp_t = False, None
            return True
        return False

    def from_ground(
        self, target: Array, climb: bool, hover_share: float, lift_s: float, t: float
    ) -> Array:
        """Idle, or the target under a cap that reaches the weight `lift_s` after the first wish."""
        if not climb:
            self._ramp_t = None
            return targets.IDLE_TARGET
        if self._ramp_t is None:
            self._ramp_t = t
        capped = target.copy()
        capped[airframe.THRUST_CAP] = hover_share * (t - self._ramp_t) / max(lift_s, 1e-3)
        return capped
