"""The personality of a small controller that takes attitude targets only, as in the paper's experiment. Ours.

Guided is a flag of base_mode, as MAVLink has it for autopilots without modes of their own: DO_SET_MODE or the
first target sets it. Landing is the only other thing it does by itself.
"""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.commands import COMMANDS, Request, whole
from ptnsbc_sim.autopilot.firmware import setpoints
from ptnsbc_sim.autopilot.firmware.firmware import HeartbeatFields
from ptnsbc_sim.autopilot.parameters import STM32, AutopilotParameters
from ptnsbc_sim.autopilot.physics import targets
from ptnsbc_sim.autopilot.physics.airframe import LoopGains
from ptnsbc_sim.autopilot.physics.frames import euler_of
from ptnsbc_sim.autopilot.vehicle import StandInVehicle

_DONE = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
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
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    )
}


class Stm32(StandInVehicle):
    """Armed, it follows quaternion, thrust and body rates; without them it comes down level."""

    autopilot = mavlink.MAV_AUTOPILOT_GENERIC
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version_word = 1 << 24
    refusal = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    ready_s = (2.0, 4.0)
    rates_hz = (_RATES_HZ, {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0})
    commands = _COMMANDS

    def default_parameters(self) -> AutopilotParameters:
        """Three."""
        return AutopilotParameters(STM32, bytewise=False)

    def gains(self) -> LoopGains:
        """Only the attitude loop and the descent matter."""
        tilt = self.parameters["MAX_TILT_RAD"]
        return LoopGains(1.0, 1.0, 2.0, 4.0, 0.0, 2.0, 5.0, 2.0, 2.0, 5.0, tilt, 8.0, 4.0, 6.0, 2.0)

    def on_boot(self, t: float) -> None:
        """Nothing heard."""
        self._target = targets.IDLE_TARGET
        self._latest_t = -math.inf
        self._guided = False
        self._land_at: targets.TargetPoint | None = None

    @property
    def mode_name(self) -> str:
        """What it does; HEARTBEAT has no name for it."""
        if self._land_at is not None:
            return "LAND"
        return "GUIDED" if self._guided else "STABILIZE"

    def status(self) -> HeartbeatFields:
        """Base mode only: custom_mode has no meaning."""
        flags = mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self._guided:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_ACTIVE
        return HeartbeatFields(flags, 0, state)

    def landed_state(self) -> int:
        """On the ground or not."""
        on_ground = self.landed if self.lifted else self.in_contact
        if self._land_at is not None and not on_ground:
            return int(mavlink.MAV_LANDED_STATE_LANDING)
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
        """Neither target nor landing are kept."""
        self._latest_t = -math.inf
        self._land_at = None

    def set_mode(self, request: Request, t: float) -> int:
        """Guided or not; there are no custom modes."""
        base = whole(request.params[0])
        if base < 0 or base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _UNSUPPORTED
        self._guided = bool(base & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
        self._land_at = None
        return _DONE

    def take_off(self, request: Request, t: float) -> int:
        """Thrust does it."""
        return _UNSUPPORTED

    def land(self, t: float) -> int:
        """Down over this place, whatever targets still come."""
        if not self.armed:
            return _DENIED
        if self._land_at is None:
            flight = self.flight
            here = targets.TargetPoint(
                flight.position_enu.copy(), euler_of(flight.attitude_enu).yaw
            )
            self._land_at = here.ahead(flight.velocity_enu)
            self.log("landing")
        return _DONE

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
            self._guided = True

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
        """Landing, else the last target while it is fresh, else down, level, in the air."""
        if not self.armed:
            return targets.OFF_TARGET
        if self._land_at is not None:
            on_ground = self.landed or not self.lifted
            return targets.IDLE_TARGET if on_ground else targets.land(self._land_at, _SINK_M_S)
        if not self._stale(t):
            return self._target
        return targets.sink(_SINK_M_S) if self.lifted and not self.landed else targets.IDLE_TARGET
