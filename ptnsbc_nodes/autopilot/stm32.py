"""The personality of a small controller that takes attitude targets only, as in the paper's experiment. Ours."""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_core.types import Array
from ptnsbc_nodes.autopilot import paths, setpoints
from ptnsbc_nodes.autopilot.airframe import LoopGains
from ptnsbc_nodes.autopilot.commands import COMMANDS, Request
from ptnsbc_nodes.autopilot.parameters import STM32, Parameters
from ptnsbc_nodes.autopilot.personality import Status
from ptnsbc_nodes.autopilot.vehicle import Vehicle
from ptnsbc_nodes.mavlink.dialect import mavlink

_UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)
_SINK_M_S = 0.5
_STANDS_ARMED_S = 10.0
_UNIT_TOLERANCE = 1e-2
_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 100.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
_COMMANDS = {
    number: COMMANDS[number]
    for number in (
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    )
}


class Stm32(Vehicle):
    """No modes: armed, it follows quaternion, thrust and body rates; without them it comes down level."""

    autopilot = mavlink.MAV_AUTOPILOT_GENERIC
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version_word = 1 << 24
    refusal = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    ready_s = (2.0, 4.0)
    rates_hz = (_RATES_HZ, {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0})
    commands = _COMMANDS

    def default_parameters(self) -> Parameters:
        """Three."""
        return Parameters(STM32, bytewise=False)

    def gains(self) -> LoopGains:
        """Only the attitude loop and the descent matter."""
        tilt = self.parameters["MAX_TILT_RAD"]
        return LoopGains(1.0, 1.0, 2.0, 4.0, 0.0, 2.0, 5.0, 2.0, 2.0, 5.0, tilt, 8.0, 4.0, 6.0, 2.0)

    def on_boot(self, t: float) -> None:
        """Nothing heard."""
        self._target = paths.IDLE_TARGET
        self._latest_t = -math.inf

    @property
    def mode_name(self) -> str:
        """It has none."""
        return "ATTITUDE"

    def status(self) -> Status:
        """Base mode only: custom_mode has no meaning."""
        flags = mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_ACTIVE
        return Status(flags, 0, state)

    def landed_state(self) -> int:
        """On the ground or not."""
        on_ground = self.landed if self.lifted else self.in_contact
        landed, air = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
        return int(landed if on_ground else air)

    def arming_problem(self, t: float) -> str | None:
        """Position and battery."""
        if self.faults.refuse_arming:
            return "gyro calibration"
        if not self.position_valid(t):
            return "no position"
        return "battery low" if self.flight.battery <= 0.1 else None

    def on_armed(self, t: float) -> None:
        """Motors at idle until a target comes."""

    def on_disarmed(self, t: float) -> None:
        """The last target is not kept."""
        self._latest_t = -math.inf

    def set_mode(self, request: Request, t: float) -> int:
        """There are no modes."""
        return _UNSUPPORTED

    def take_off(self, request: Request, t: float) -> int:
        """Thrust does it."""
        return _UNSUPPORTED

    def land(self, t: float) -> int:
        """Thrust does it."""
        return _UNSUPPORTED

    def return_home(self, t: float) -> int:
        """It knows no home."""
        return _UNSUPPORTED

    def pilot(self, mode: str, t: float) -> bool:
        """There are no modes to switch."""
        return False

    def on_trajectory(self, message: Any, t: float) -> None:
        """Not understood."""

    def on_attitude(self, message: Any, t: float) -> None:
        """Attitude and thrust must be there; body rates are added where they are."""
        wanted = setpoints.attitude(message)
        if wanted.attitude_ned is None or not math.isfinite(wanted.thrust):
            return
        if setpoints.unit(wanted.attitude_ned, _UNIT_TOLERANCE):
            self._target, self._latest_t = setpoints.attitude_target(wanted), t

    def _stale(self, t: float) -> bool:
        return t - self._latest_t > self.parameters["ATT_TIMEOUT_S"]

    def watch(self, t: float) -> None:
        """Motors off after landing, or when it only stands there."""
        if not self.armed:
            return
        if self.lifted and self.flight.standing_s > self.parameters["DISARM_LAND_S"]:
            self.disarm("landed", t)
        elif not self.lifted and t - self.armed_t > _STANDS_ARMED_S:
            self.disarm("not taken off in time", t)

    def aim(self, t: float) -> Array:
        """The last target while it is fresh; else down, level, in the air."""
        if not self.armed:
            return paths.OFF_TARGET
        if not self._stale(t):
            return self._target
        return paths.sink(_SINK_M_S) if self.lifted and not self.landed else paths.IDLE_TARGET
