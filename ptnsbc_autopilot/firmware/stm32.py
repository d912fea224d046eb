"""The firmware of a small controller that takes attitude targets only, as in the paper's experiment. Ours.

Guided is a flag of base_mode, as MAVLink has it for autopilots without custom modes: DO_SET_MODE or the first
target sets it. Beside that it can land.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from ptnsbc_autopilot.commands import whole
from ptnsbc_autopilot.controller import FlightController
from ptnsbc_autopilot.firmware import setpoints
from ptnsbc_autopilot.parameters import STM32, AutopilotParameters
from ptnsbc_autopilot.physics import targets
from ptnsbc_autopilot.physics.airframe import LoopGains
from ptnsbc_autopilot.vehicle import HeartbeatFields, Request
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

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


class Stm32(FlightController):
    """Armed, it follows quaternion, thrust and body rates; without setpoints it comes down level."""

    autopilot = mavlink.MAV_AUTOPILOT_GENERIC
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version_word = 1 << 24
    refusal = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    ready_s = (2.0, 4.0)
    rates_hz = (_RATES_HZ, {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0})
    has_logs = False
    command_ids = frozenset(
        (
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
            mavlink.MAV_CMD_DO_SET_MODE,
            mavlink.MAV_CMD_NAV_LAND,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            mavlink.MAV_CMD_REQUEST_MESSAGE,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
        )
    )

    def default_parameters(self) -> AutopilotParameters:
        """Its own parameters."""
        return AutopilotParameters(STM32, bytewise=False)

    def gains(self) -> LoopGains:
        """Only the attitude loop and the descent matter."""
        tilt = self.parameters["MAX_TILT_RAD"]
        return LoopGains(1.0, 1.0, 2.0, 4.0, 0.0, 2.0, 5.0, 2.0, 2.0, 5.0, tilt, 8.0, 4.0, 6.0, 2.0)

    def on_boot(self, t: float) -> None:
        """Without setpoints."""
        self._target = targets.IDLE_TARGET
        self._late: deque[tuple[float, Array]] = deque()  # targets, and when they count
        self._latest_t = -math.inf
        self._guided = False
        self._land_at: targets.TargetPoint | None = None

    @property
    def mode_name(self) -> str:
        """The present activity; HEARTBEAT has no mode for it."""
        if self._land_at is not None:
            return "LAND"
        return "GUIDED" if self._guided else "STABILIZE"

    def heartbeat_fields(self, t: float) -> HeartbeatFields:
        """Base mode only; custom_mode is not used."""
        flags = mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self._guided:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_ACTIVE
        return HeartbeatFields(flags, 0, state)

    def landed_state(self) -> int:
        """On the ground, landing, or in the air."""
        on_ground = self.landed if self.lifted else self.in_contact
        if self._land_at is not None and not on_ground:
            return int(mavlink.MAV_LANDED_STATE_LANDING)
        landed, air = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
        return int(landed if on_ground else air)

    def arming_problem(self, t: float) -> str | None:
        """The first failed check."""
        if self.faults.refuse_arming:
            return "gyro calibration"
        if not self.position_valid(t):
            return "no position"
        return "battery low" if self.flight.battery <= 0.1 else None

    def on_armed(self, t: float) -> None:
        """The motors idle until a target arrives."""
        self.flight.endurance_s = self.parameters["BATT_LIFE_S"]

    def on_disarmed(self, t: float) -> None:
        """Target and landing end."""
        self._latest_t = -math.inf
        self._land_at = None

    def fly(self, request: Request, t: float) -> int:
        """Set or clear guided, as there are no custom modes; or land. Attitude targets take off by their thrust."""
        if request.command == mavlink.MAV_CMD_NAV_LAND:
            return self._land(t)
        base = whole(request.params[0])
        unknown = base < 0 or base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if request.command != mavlink.MAV_CMD_DO_SET_MODE or unknown:
            return _UNSUPPORTED
        self._guided = bool(base & mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
        self._land_at = None
        return _DONE

    def _land(self, t: float) -> int:
        """Come down over this position; targets that still arrive are ignored."""
        if not self.armed:
            return _DENIED
        if self._land_at is None:
            estimate = self.flight.estimate
            here = targets.TargetPoint(estimate.position_enu.copy(), estimate.yaw_enu)
            self._land_at = here.after_braking(estimate.velocity_enu)
            self.log("landing")
        return _DONE

    def set_mode_by_rc(self, mode: str, t: float) -> bool:
        """There are no modes to select."""
        return False

    def on_setpoint(self, message: Any, t: float) -> None:
        """Attitude and thrust are required, body rates are added when present; position targets are ignored."""
        if message.get_type() != "SET_ATTITUDE_TARGET":
            return
        wanted = setpoints.read_attitude(message)
        if wanted.attitude_ned is None or not math.isfinite(wanted.thrust):
            return
        if setpoints.is_unit(wanted.attitude_ned, _UNIT_TOLERANCE):
            # Motors without a speed loop: the force grows with a power of the thrust, and falls with the battery.
            sag = self.parameters["THR_SAG"] * (1.0 - self.flight.battery)
            force = max(wanted.thrust, 0.0) ** self.parameters["THR_CURVE"] * (1.0 - sag)
            target = setpoints.attitude_airframe_target(wanted._replace(thrust=force))
            self._late.append((t + self.parameters["THR_DELAY_S"], target))
            self._latest_t, self._guided = t, True

    def update_mode(self, t: float) -> None:
        """Disarm after landing, or after 10 s of standing armed."""
        if not self.armed:
            return
        if self.lifted and self.flight.standing_s > self.parameters["DISARM_LAND_S"]:
            self.disarm("landed", t)
        elif not self.lifted and t - self.armed_t > _STANDS_ARMED_S:
            self.disarm("not taken off in time", t)

    def airframe_target(self, t: float) -> Array:
        """The landing, else the last target while it is fresh, else down and level."""
        if not self.armed:
            return targets.OFF_TARGET
        if self._land_at is not None:
            on_ground = self.landed or not self.lifted
            return targets.IDLE_TARGET if on_ground else targets.climb(self._land_at, -_SINK_M_S)
        while self._late and self._late[0][0] <= t:
            self._target = self._late.popleft()[1]
        if t - self._latest_t <= self.parameters["ATT_TIMEOUT_S"]:
            return self._target
        return targets.sink(_SINK_M_S) if self.lifted and not self.landed else targets.IDLE_TARGET
