"""The firmware of ArduCopter 4.7: modes, arming, GUIDED, failsafes. Sources: docs/autopilot.md."""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_autopilot.commands import custom_mode, whole
from ptnsbc_autopilot.controller import FlightController
from ptnsbc_autopilot.firmware.guided import EstimatedState, Guided, Submode, WaypointLimits
from ptnsbc_autopilot.parameters import ARDUCOPTER, AutopilotParameters
from ptnsbc_autopilot.physics import targets
from ptnsbc_autopilot.physics.airframe import LoopGains, hover_share
from ptnsbc_autopilot.physics.frames import ARDUPILOT_RADIUS_M
from ptnsbc_autopilot.vehicle import HeartbeatFields, Request
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

_DONE = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_FAILED = int(mavlink.MAV_RESULT_FAILED)
_UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)

STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 2, 4, 5, 6, 9, 17
_NAMES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    LAND: "LAND",
    BRAKE: "BRAKE",
}
MODES = {name: number for number, name in _NAMES.items()}
_MODE_OF = {mavlink.MAV_CMD_NAV_LAND: LAND, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: RTL}
_NEED_POSITION = (GUIDED, LOITER, RTL, BRAKE)
_MANUAL = (STABILIZE, ALT_HOLD)

THRUST_IS_THRUST = 8
"""Bit of GUID_OPTIONS: the thrust of SET_ATTITUDE_TARGET is a thrust, not a climb rate."""

_SPOOL_UP_S = 1.0
_PATH_TILT_GAIN_1_S = (
    6.0  # as measured: ATC_ANG_RLL_P is 4.5, and the rates of the shaped tilt are fed forward
)
_SINK_M_S = 0.5
_SLOW_BELOW_M = 10.0


class ArduCopter(FlightController):
    """ArduCopter on a quadrotor without a transmitter."""

    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version_word = 4 << 24 | 7 << 16
    first_log = 1
    refusal = _FAILED
    earth_radius_m = ARDUPILOT_RADIUS_M
    drag_1_s = 0.2  # of its simulated quadrotor: the momentum drag of the rotors
    ready_s = (20.0, 40.0)
    rates_hz = ({mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}, {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0})

    def default_parameters(self) -> AutopilotParameters:
        """ArduCopter's, with the learned hover thrust."""
        learned = {"MAV_SYSID": self.system, "MOT_THST_HOVER": hover_share(self.body.plant)}
        return AutopilotParameters({**ARDUCOPTER, **learned}, bytewise=False)

    def gains(self) -> LoopGains:
        """From PSC_*, WP_* and ATC_*."""
        p = self.parameters
        speed, up, down = p["WP_SPD"], p["WP_SPD_UP"], p["WP_SPD_DN"]
        return LoopGains(
            p["PSC_NE_POS_P"],
            1.0,
            p["PSC_NE_VEL_P"],
            4.0,
            p["PSC_NE_VEL_I"],
            2.0,
            speed + 1.0,
            up,
            down,
            5.0,
            math.radians(p["ATC_ANGLE_MAX"]),
            9.0,
            4.5,
            3.8,
            1.0,
            derivative=p["PSC_NE_VEL_D"],
            of_error=True,
            error_s=1.0 / (2.0 * math.pi * p["PSC_NE_VEL_FLTE"]),
            tilt_s=p["ATC_INPUT_TC"],
            path_tilt_gain=_PATH_TILT_GAIN_1_S,
        )

    # State.

    def on_boot(self, t: float) -> None:
        """In STABILIZE."""
        self.mode = STABILIZE
        self._transmitter = False
        self._announced = False
        self._auto_armed = False  # whether a request leads off the ground
        self._land_complete = True
        self._hold_point = targets.TargetPoint(self.flight.estimate.position_enu.copy(), 0.0)
        self._guided = Guided(_estimate(self), t)

    @property
    def mode_name(self) -> str:
        """Name of the mode."""
        return _NAMES[self.mode]

    def heartbeat_fields(self, t: float) -> HeartbeatFields:
        """HEARTBEAT; standby while the land detector reports landed, armed or not."""
        flags = (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        )
        if self.mode not in _MANUAL:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        landed = self._land_complete
        state = mavlink.MAV_STATE_STANDBY if landed else mavlink.MAV_STATE_ACTIVE
        return HeartbeatFields(flags, self.mode, state)

    def landed_state(self) -> int:
        """By the land detector and the mode."""
        if self._land_complete:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.mode == LAND:
            return int(mavlink.MAV_LANDED_STATE_LANDING)
        if self.mode == GUIDED and self._guided.submode is Submode.TAKE_OFF:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        return int(mavlink.MAV_LANDED_STATE_IN_AIR)

    # Arming and modes.

    def arming_problem(self, t: float) -> str | None:
        """The first failed check."""
        if self.faults.refuse_arming:
            return "Compasses inconsistent"
        if self.mode in _NEED_POSITION and not self.position_valid(t):
            return "Need Position Estimate"
        if self.mode in (LAND, RTL, BRAKE):
            return f"{self.mode_name} mode not armable"
        if self.flight.battery <= 0.07:
            return "Battery below minimum arming voltage"
        return None

    def on_armed(self, t: float) -> None:
        """On the ground, motors at idle, without a take-off request."""
        self._auto_armed = False
        self._guided = Guided(_estimate(self), t)

    def on_disarmed(self, t: float) -> None:
        """The mode does not change."""
        self._auto_armed = False

    def _change_mode(self, mode: int, t: float) -> bool:
        if mode in _NEED_POSITION and not self.position_valid(t):
            self.send_text(f"Mode change to {_NAMES[mode]} failed: requires position", t)
            return False
        if mode != self.mode:
            self.log(f"mode {_NAMES[mode]}")
        state = _estimate(self)
        self.mode = mode
        self._hold_point = targets.TargetPoint(state.position, self.flight.estimate.yaw_enu)
        self._hold_point = self._hold_point.after_braking(state.velocity)
        self._guided = Guided(state, t)
        return True

    def fly(self, request: Request, t: float) -> int:
        """A mode by its number in param2; or take off in GUIDED, armed and landed, to param7 above home."""
        command, params = request.command, request.params
        if command == mavlink.MAV_CMD_NAV_TAKEOFF:
            ready = self.mode == GUIDED and self.armed and self._land_complete
            if not ready or not math.isfinite(params[6]) or params[6] <= 0.0:
                return _FAILED
            self._guided.take_off(_estimate(self), float(self.home_local_enu[2]) + params[6])
            self._auto_armed = True
            return _DONE
        if command == mavlink.MAV_CMD_DO_SET_MODE and not custom_mode(request):
            return _UNSUPPORTED
        mode = _MODE_OF.get(command, whole(params[1]))
        return _DONE if mode in _NAMES and self._change_mode(mode, t) else _FAILED

    def set_mode_by_rc(self, mode: str, t: float) -> bool:
        """A transmitter's switch selects a mode; the sticks are centred."""
        if mode.upper() not in MODES:
            return False
        self._transmitter = True
        self._change_mode(MODES[mode.upper()], t)
        return True

    def on_setpoint(self, message: Any, t: float) -> None:
        """Outside GUIDED it is ignored without an answer. One that is not valid stops the vehicle.

        A position target ends a take-off, on the ground too. A positive climb rate or thrust leads off the ground.
        """
        if self.mode != GUIDED:
            return
        state = _estimate(self)
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            if not self._guided.take_position_target(message, state, t):
                self._guided = Guided(state, t)
            return
        as_thrust = bool(whole(self.parameters["GUID_OPTIONS"]) & THRUST_IS_THRUST)
        if not self._guided.take_attitude_target(message, _limits(self), as_thrust, t):
            self._guided = Guided(state, t)
        if self.armed and self._guided.climbs and message.thrust > 0.0:
            self._auto_armed = True

    # Rules that act without a command.

    def update_mode(self, t: float) -> None:
        """Land detector, disarming, loss of the position."""
        if not self._announced and self.position_valid(t):
            self._announced = True
            self.send_text("EKF3 IMU0 is using GPS", t, mavlink.MAV_SEVERITY_INFO)
        if not self.in_contact:
            self._land_complete = False
        elif self.landed and not self._land_complete:
            self._land_complete = True
            self._auto_armed = False
            self.log("landed")
        if not self.armed:
            return
        if self.mode in _NEED_POSITION and not self.position_valid(t):
            self.send_text("EKF Failsafe: LAND", t)
            self._change_mode(LAND, t)
        if self._land_complete and self.lifted and self.mode in (LAND, RTL):
            self.disarm("landed", t)
            return
        delay = self.parameters["DISARM_DELAY"]
        stood = min(self.flight.standing_s, t - self.armed_t)
        if self._land_complete and not self._auto_armed and 0.0 < delay < stood:
            self.disarm("standing", t)

    # The target of the airframe.

    def airframe_target(self, t: float) -> Array:
        """Motors off, at idle, or the target of the mode."""
        if not self.armed:
            return targets.OFF_TARGET
        # It leaves the ground by a take-off, or by an attitude target that climbs.
        leaves = self._guided.submode is Submode.TAKE_OFF or self._guided.climbs
        flies = not self._land_complete or (self.mode == GUIDED and self._auto_armed and leaves)
        if t - self.armed_t < _SPOOL_UP_S or not flies:
            return targets.IDLE_TARGET
        if self.mode == GUIDED:
            timeout_s = self.parameters["GUID_TIMEOUT"]
            return self._guided.airframe_target(_estimate(self), _limits(self), timeout_s, t)
        if self.mode in _MANUAL and not self._transmitter:
            return targets.sink(_SINK_M_S)
        if self.mode == LAND and not self.position_valid(t):
            return targets.sink(_SINK_M_S)
        position, home = self.flight.estimate.position_enu, self.home_local_enu
        slow = position[2] - home[2] < _SLOW_BELOW_M
        down_m_s = self.parameters["LAND_SPD_MS" if slow else "WP_SPD_DN"]
        if self.mode == LAND:
            return targets.climb(self._hold_point, -down_m_s)
        if self.mode == RTL:
            height = home[2] + self.parameters["RTL_ALT_M"]
            way = targets.return_point(position, home, height, self._hold_point)
            return targets.climb(way, -down_m_s) if way.over_home else targets.hold(way)
        return targets.hold(self._hold_point)


def _estimate(vehicle: ArduCopter) -> EstimatedState:
    estimate = vehicle.flight.estimate
    position, velocity = estimate.position_enu.copy(), estimate.velocity_enu.copy()
    return EstimatedState(position, velocity, estimate.heading_ned)


def _limits(vehicle: ArduCopter) -> WaypointLimits:
    """Limits of GUIDED."""
    p = vehicle.parameters
    return WaypointLimits(
        p["WP_SPD"],
        p["WP_SPD_UP"],
        p["WP_SPD_DN"],
        p["WP_ACC"],
        p["WP_ACC_Z"],
        p["PSC_JERK_NE"],
        p["PSC_JERK_D"],
    )
