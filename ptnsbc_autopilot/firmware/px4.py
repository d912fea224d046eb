"""The firmware of a PX4 multicopter: modes, arming, offboard setpoints, failsafes. Sources: docs/autopilot.md."""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_autopilot.commands import custom_mode, whole
from ptnsbc_autopilot.controller import FlightController
from ptnsbc_autopilot.firmware.px4_modes import (
    DESCEND,
    HOLD,
    LAND,
    MANUAL_MODES,
    MODES,
    NEED_POSITION,
    OFFBOARD,
    OFFBOARD_LOSS,
    RATES_HZ,
    RTL,
    TAKEOFF,
    TRANSIENT_MODES,
    Px4Mode,
)
from ptnsbc_autopilot.firmware.px4_offboard import (
    LIFT_SHARE_OF_RAMP,
    OffboardSetpoint,
    OffboardStream,
    TakeoffRamp,
    read_attitude,
    read_position_target,
)
from ptnsbc_autopilot.parameters import PX4, AutopilotParameters
from ptnsbc_autopilot.physics import airframe, targets
from ptnsbc_autopilot.physics.airframe import LoopGains
from ptnsbc_autopilot.physics.body import VehiclePhysics
from ptnsbc_autopilot.vehicle import HeartbeatFields, Request
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

STREAM_BEFORE_S = 1.0
"""The time for which setpoints must arrive before offboard can be entered.

https://docs.px4.io/main/en/flight_modes/offboard
"""

_MODE_OF = {mavlink.MAV_CMD_NAV_LAND: LAND, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: RTL}
_DONE = int(mavlink.MAV_RESULT_ACCEPTED)
_LATER = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_AUTO_FLAGS = (
    mavlink.MAV_MODE_FLAG_AUTO_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
)
_SINK_M_S = 0.7
_PATH_TILT_GAIN_1_S = 10.0  # as measured: with MC_ROLL_P, 6.5, the lag would be 0.1 s longer
_SLOW_BELOW_M = 5.0
_FAST_DOWN_M_S = 1.5
_ARRIVED_M = 0.2


class Px4(FlightController):
    """PX4 1.16 on a quadrotor without a transmitter."""

    autopilot = mavlink.MAV_AUTOPILOT_PX4
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    version_word = 1 << 24 | 16 << 16
    refusal = _LATER
    text_end = "\t"
    text_to_companions = False
    refusal_text = "Arming denied"
    ready_s = (3.0, 8.0)
    drag_1_s = 1.0  # of its built-in simulated quadrotor
    rates_hz = RATES_HZ

    def default_parameters(self) -> AutopilotParameters:
        """PX4's, with our system id."""
        return AutopilotParameters({**PX4, "MAV_SYS_ID": self.system}, bytewise=True)

    def gains(self) -> LoopGains:
        """From MPC_* and MC_*."""
        p = self.parameters
        return LoopGains(
            p["MPC_XY_P"],
            p["MPC_Z_P"],
            p["MPC_XY_VEL_P_ACC"],
            p["MPC_Z_VEL_P_ACC"],
            p["MPC_XY_VEL_I_ACC"],
            p["MPC_Z_VEL_I_ACC"],
            p["MPC_XY_VEL_MAX"],
            p["MPC_Z_VEL_MAX_UP"],
            p["MPC_Z_VEL_MAX_DN"],
            p["MPC_ACC_HOR_MAX"],
            math.radians(p["MPC_TILTMAX_AIR"]),
            p["MC_ROLL_P"],
            p["MC_YAW_P"],
            3.8,
            math.radians(p["MPC_YAWRAUTO_MAX"]),
            derivative=p["MPC_XY_VEL_D_ACC"],
            path_tilt_gain=_PATH_TILT_GAIN_1_S,
        )

    # State.

    def on_boot(self, t: float) -> None:
        """In Hold, without setpoints and without a transmitter."""
        self.mode = HOLD  # requested
        self.active = HOLD  # active: another one in a failsafe
        self._mode_after_disarm = HOLD
        self._transmitter = False
        self._offboard = OffboardStream()
        self._takeoff = TakeoffRamp()
        self._hold_point = _here(self.flight)
        self._takeoff_height = 0.0
        self._last_charge = 1.0

    @property
    def mode_name(self) -> str:
        """Name of the active mode."""
        return self.active.name

    def heartbeat_fields(self, t: float) -> HeartbeatFields:
        """HEARTBEAT shows the active mode; a disarmed vehicle is not initialised while its checks fail."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        manual = mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        flags |= manual if self.active in MANUAL_MODES else _AUTO_FLAGS
        ready = self.armed or self.arming_problem(t) is None
        state = mavlink.MAV_STATE_STANDBY if ready else mavlink.MAV_STATE_UNINIT
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = (
                mavlink.MAV_STATE_CRITICAL if self.active != self.mode else mavlink.MAV_STATE_ACTIVE
            )
        return HeartbeatFields(flags, self.active.word, state)

    def landed_state(self) -> int:
        """On the ground until it lifts off; then by the mode."""
        if self.in_contact and (not self._takeoff.flying or self.landed):
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.active == TAKEOFF:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        if self.active in (LAND, DESCEND):
            return int(mavlink.MAV_LANDED_STATE_LANDING)
        return int(mavlink.MAV_LANDED_STATE_IN_AIR)

    # Arming and modes.

    def arming_problem(self, t: float) -> str | None:
        """The first failed check."""
        if self.faults.refuse_arming:
            return "Resolve system health failures first"
        if self.flight.battery <= self.parameters["BAT_CRIT_THR"]:
            return "Critical battery"
        if self.parameters["NAV_DLL_ACT"] > 0 and not any(
            self.gcs_on(link, t) for link in self.gcs_heard
        ):
            return "No connection to the ground control station"
        if self.mode == OFFBOARD and not _offboard_alive(self, t, STREAM_BEFORE_S):
            return "No offboard signal"
        if self.mode in NEED_POSITION and not self.position_valid(t):
            return "Global position required"
        if self.mode in MANUAL_MODES and not self._transmitter:
            return "Manual control unavailable"
        return None

    def on_armed(self, t: float) -> None:
        """On the ground, motors at idle."""
        self._takeoff = TakeoffRamp()
        self._hold_point = _here(self.flight)

    def on_disarmed(self, t: float) -> None:
        """After take-off, landing or return the mode before them is restored."""
        if self.mode in TRANSIENT_MODES:
            self.mode = self._mode_after_disarm
        self.active = self.mode
        self._takeoff = TakeoffRamp()

    def change_mode(self, mode: Px4Mode, t: float) -> int:
        """Change the mode; a disarmed vehicle takes any mode, and arming checks it."""
        if self.armed and not _can_run(self, mode, t):
            self.send_text(f"Switching to mode '{mode.name}' is currently not available", t)
            return _LATER
        if mode != self.mode:
            self.log(f"mode {mode.name}")
        self.mode = self.active = mode
        self._hold_point = _here(self.flight)
        if mode not in TRANSIENT_MODES:
            self._mode_after_disarm = mode
        return _DONE

    def fly(self, request: Request, t: float) -> int:
        """DO_SET_MODE: param2 and param3 are main and sub mode. NAV_TAKEOFF: param7 is the height above sea level."""
        command, params = request.command, request.params
        if command in _MODE_OF:
            return self.change_mode(_MODE_OF[command], t)
        if command == mavlink.MAV_CMD_NAV_TAKEOFF:
            result = self.change_mode(TAKEOFF, t)
            if result == _DONE:
                ground = self.flight.body.datum.altitude_m + self.flight.navigation.origin_enu[2]
                least = self.home_local_enu[2] + self.parameters["MIS_TAKEOFF_ALT"]
                given = math.isfinite(params[6])
                self._takeoff_height = float(params[6] - ground if given else least)
            return result
        numbers = (whole(params[1]), whole(params[2]))
        known = [mode for mode in MODES if (mode.main, mode.sub) == numbers]
        return self.change_mode(known[0], t) if known and custom_mode(request) else _DENIED

    def set_mode_by_rc(self, mode: str, t: float) -> bool:
        """A transmitter appears, and its switch selects a mode; the sticks are centred."""
        for known in MODES:
            if known.name == mode.upper():
                self._transmitter = True
                self.change_mode(known, t)
                return True
        return False

    # Setpoints.

    def on_setpoint(self, message: Any, t: float) -> None:
        """Frames and masks as PX4's receiver takes them; a wrong one does not keep offboard alive."""
        if message.get_type() == "SET_ATTITUDE_TARGET":  # attitude or body rates, with a thrust
            read: OffboardSetpoint | str | None = read_attitude(message)
        else:
            estimate = self.flight.estimate
            read = read_position_target(message, estimate.heading_ned, estimate.position_enu[2])
        if isinstance(read, str):
            self.send_text(read, t)
        elif read is not None:
            self._offboard.take(read, t, self.parameters["COM_OF_LOSS_T"])

    # Rules that act without a command.

    def update_mode(self, t: float) -> None:
        """Failsafes, end of take-off, disarming, battery."""
        if not self.armed:
            return
        _apply_failsafes(self, t)
        climb_m = self._takeoff_height - self.flight.estimate.position_enu[2]
        if self.active == TAKEOFF and climb_m < _ARRIVED_M:
            self.change_mode(HOLD, t)
        if self._takeoff.update(self.in_contact, self.landed):
            self.log("landed")
        waits_s, stands_s = self.parameters["COM_DISARM_PRFLT"], self.parameters["COM_DISARM_LAND"]
        waits = not (self.lifted or self.faults.takeoff_detected)
        if waits and 0.0 < waits_s < t - self.armed_t:
            self.disarm("not taken off in time", t)
        elif self.lifted and self.landed and 0.0 < stands_s < self.flight.standing_s - 1.0:
            self.disarm("landed", t)
        charge, before = self.flight.battery, self._last_charge
        self._last_charge = charge
        if charge <= self.parameters["BAT_LOW_THR"] < before:
            self.send_text("Low battery level, return advised", t)
        if charge <= self.parameters["BAT_CRIT_THR"] < before:
            self.send_text("Critical battery level, land now", t)
            if self.parameters["COM_LOW_BAT_ACT"] >= 2.0 and not self.in_contact:
                self.change_mode(LAND, t)

    # The target of the airframe.

    def airframe_target(self, t: float) -> Array:
        """Motors off, at idle, ramping up, or the target of the mode."""
        if not self.armed:
            return targets.OFF_TARGET
        if t - self.armed_t < self.parameters["COM_SPOOLUP_TIME"]:
            return targets.IDLE_TARGET
        target = _mode_target(self)
        if target[airframe.KIND] != airframe.TRAJECTORY or self._takeoff.flying:
            return target
        offboard = self.active == OFFBOARD
        climbs = self._offboard.setpoint.climbs if offboard else self.active == TAKEOFF
        lift_s = LIFT_SHARE_OF_RAMP * self.parameters["MPC_TKO_RAMP_T"]
        return self._takeoff.target(target, climbs, self.flight.hover_share, lift_s, t)


def _here(flight: VehiclePhysics) -> targets.TargetPoint:
    return targets.TargetPoint(flight.estimate.position_enu.copy(), flight.estimate.yaw_enu)


def _offboard_alive(px4: Px4, t: float, streamed_s: float = 0.0) -> bool:
    """True if setpoints arrive, for so long already, and the position is valid if they need it."""
    offboard = px4._offboard
    if not offboard.fresh(t, px4.parameters["COM_OF_LOSS_T"]):
        return False
    needs = offboard.needs_position and not px4.position_valid(t)
    return not needs and offboard.streamed_s(t) >= streamed_s


def _can_run(px4: Px4, mode: Px4Mode, t: float) -> bool:
    if mode == OFFBOARD:
        return _offboard_alive(px4, t, STREAM_BEFORE_S)
    if mode in MANUAL_MODES and not px4._transmitter:
        return False
    return mode not in NEED_POSITION or px4.position_valid(t) or mode == LAND


def _apply_failsafes(px4: Px4, t: float) -> None:
    """The active mode: the requested one while it can run, else that of the failsafe."""
    wanted = px4.mode
    if wanted == OFFBOARD and not _offboard_alive(px4, t):
        action = int(px4.parameters["COM_OBL_RC_ACT"])
        if action not in OFFBOARD_LOSS:
            px4.disarm("offboard signal lost", t)
            return
        wanted = OFFBOARD_LOSS[action]
    if wanted in NEED_POSITION and not px4.position_valid(t):
        wanted = DESCEND
    if wanted == px4.active:
        return
    if wanted == px4.mode:
        px4.send_text(f"Failsafe cleared: back to {wanted.name}", t)
    else:
        px4.send_text(f"Failsafe activated: {wanted.name}", t)
    px4.active = wanted
    px4._hold_point = _here(px4.flight).after_braking(px4.flight.estimate.velocity_enu)


def _mode_target(px4: Px4) -> Array:
    """The target (22,) of the active mode, once the vehicle may lift."""
    mode, place, p = px4.active, px4._hold_point, px4.parameters
    position, home = px4.flight.estimate.position_enu, px4.home_local_enu
    if mode == OFFBOARD:
        return px4._offboard.setpoint.target
    if mode == DESCEND or (mode in MANUAL_MODES and not px4._transmitter):
        return targets.sink(_SINK_M_S)
    if mode == TAKEOFF:
        climb = px4._takeoff_height - position[2]
        return targets.climb(place, min(float(climb), p["MPC_TKO_SPEED"]))
    slow = position[2] - home[2] < _SLOW_BELOW_M
    down_m_s = p["MPC_LAND_SPEED"] if slow else _FAST_DOWN_M_S
    if mode == LAND:
        return targets.climb(place, -down_m_s)
    if mode == RTL:
        way = targets.return_point(position, home, home[2] + p["RTL_RETURN_ALT"], place)
        return targets.climb(way, -down_m_s) if way.over_home else targets.hold(way)
    return targets.hold(place)
