"""What is asked of a PX4: modes, arming, offboard setpoints. Sources: docs/autopilot.md."""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.commands import Request, custom_mode, whole
from ptnsbc_sim.autopilot.firmware.firmware import HeartbeatFields
from ptnsbc_sim.autopilot.firmware.px4_offboard import (
    LiftOff,
    Offboard,
    read_attitude,
    read_trajectory,
)
from ptnsbc_sim.autopilot.firmware.px4_tables import (
    DESCEND,
    HOLD,
    LAND,
    MANUAL_MODES,
    MODES,
    NEED_POSITION,
    OFFBOARD,
    PASSING_MODES,
    RATES_HZ,
    RTL,
    TAKEOFF,
    Px4Mode,
)
from ptnsbc_sim.autopilot.parameters import PX4, AutopilotParameters
from ptnsbc_sim.autopilot.physics import targets
from ptnsbc_sim.autopilot.physics.airframe import LoopGains
from ptnsbc_sim.autopilot.physics.frames import attitude_swap, euler_of
from ptnsbc_sim.autopilot.vehicle import StandInVehicle

_DONE = int(mavlink.MAV_RESULT_ACCEPTED)
_LATER = int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)

STREAM_BEFORE_S = 1.0
"""How long setpoints must have come before offboard can be entered.

https://docs.px4.io/main/en/flight_modes/offboard
"""


_FIXED_FLAGS = (
    mavlink.MAV_MODE_FLAG_AUTO_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
)


class Px4Modes(StandInVehicle):
    """What is asked of a PX4 1.16 on a quadrotor without a transmitter."""

    autopilot = mavlink.MAV_AUTOPILOT_PX4
    capabilities = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    version_word = 1 << 24 | 16 << 16
    refusal = _LATER
    text_end = "\t"
    ready_s = (3.0, 8.0)
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
        )

    # State.

    def on_boot(self, t: float) -> None:
        """In Hold, nothing heard, no transmitter."""
        self.mode = HOLD  # what the user wants
        self.active = HOLD  # what is flown
        self._after_disarm = HOLD
        self._transmitter = False
        self._offboard = Offboard()
        self._lift = LiftOff()
        self._place = self._here()
        self._height = 0.0
        self._warned_charge = 1.0

    def _here(self) -> targets.TargetPoint:
        yaw = euler_of(self.flight.attitude_enu).yaw
        return targets.TargetPoint(self.flight.position_enu.copy(), yaw)

    @property
    def mode_name(self) -> str:
        """Name of the mode that is flown."""
        return self.active.name

    @property
    def failsafe(self) -> bool:
        """Whether something else is flown than the user wants."""
        return self.armed and self.active != self.mode

    def status(self) -> HeartbeatFields:
        """HEARTBEAT shows the mode that is flown."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        manual = mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        flags |= manual if self.active in MANUAL_MODES else _FIXED_FLAGS
        state = mavlink.MAV_STATE_STANDBY
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_CRITICAL if self.failsafe else mavlink.MAV_STATE_ACTIVE
        return HeartbeatFields(flags, self.active.word, state)

    def landed_state(self) -> int:
        """On the ground until it has left it; landing and take-off only where the mode says so."""
        if self.in_contact and (not self._lift.flying or self.landed):
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.active == TAKEOFF:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        if self.active in (LAND, DESCEND):
            return int(mavlink.MAV_LANDED_STATE_LANDING)
        return int(mavlink.MAV_LANDED_STATE_IN_AIR)

    def refusal_text(self, problem: str) -> str:
        """As PX4 says it."""
        return f"Arming denied: {problem}"

    def text_links(self, t: float) -> list[int]:
        """Only links on which a ground station is heard."""
        return [link for link in super().text_links(t) if self.gcs_on(link, t)]

    # Arming and modes.

    def arming_problem(self, t: float) -> str | None:
        """The first check that fails."""
        if self.faults.refuse_arming:
            return "Resolve system health failures first"
        if self.flight.battery <= self.parameters["BAT_CRIT_THR"]:
            return "Critical battery"
        if self.parameters["NAV_DLL_ACT"] > 0 and not self.gcs_present(t):
            return "No connection to the ground control station"
        if self.mode == OFFBOARD and not self._offboard_ready(t):
            return "No offboard signal"
        if self.mode in NEED_POSITION and not self.position_valid(t):
            return "Global position required"
        if self.mode in MANUAL_MODES and not self._transmitter:
            return "Manual control unavailable"
        return None

    def on_armed(self, t: float) -> None:
        """On the ground, motors at idle."""
        self._lift = LiftOff()
        self._place = self._here()

    def on_disarmed(self, t: float) -> None:
        """Take-off, landing and return are forgotten: the mode before them is back."""
        if self.mode in PASSING_MODES:
            self.mode = self._after_disarm
        self.active = self.mode
        self._lift = LiftOff()

    def _can_run(self, mode: Px4Mode, t: float) -> bool:
        if mode == OFFBOARD:
            return self._offboard_ready(t)
        if mode in MANUAL_MODES and not self._transmitter:
            return False
        return mode not in NEED_POSITION or self.position_valid(t) or mode == LAND

    def _choose(self, mode: Px4Mode, t: float) -> int:
        """Change the mode; disarmed it is always taken, arming checks it."""
        if self.armed and not self._can_run(mode, t):
            self.tell(f"Switching to mode '{mode.name}' is currently not available", t)
            return _LATER
        if mode != self.mode:
            self.log(f"mode {mode.name}")
        self.mode = self.active = mode
        self._place = self._here()
        if mode not in PASSING_MODES:
            self._after_disarm = mode
        return _DONE

    def set_mode(self, request: Request, t: float) -> int:
        """param1 says that custom modes are meant, param2 and 3 are main and sub mode."""
        if not custom_mode(request):
            return _DENIED
        main, sub = whole(request.params[1]), whole(request.params[2])
        for mode in MODES:
            if (mode.main, mode.sub) == (main, sub):
                return self._choose(mode, t)
        return _DENIED

    def take_off(self, request: Request, t: float) -> int:
        """Switches to the mode; param7 is the height above sea level, NaN for MIS_TAKEOFF_ALT."""
        result = self._choose(TAKEOFF, t)
        if result == _DONE:
            wanted = request.params[6]
            ground = self.flight.body.datum.altitude_m + self.flight.navigation.origin_enu[2]
            least = self.home_local_enu[2] + self.parameters["MIS_TAKEOFF_ALT"]
            self._height = float(wanted - ground if math.isfinite(wanted) else least)
        return result

    def land(self, t: float) -> int:
        """Switches to the mode."""
        return self._choose(LAND, t)

    def return_home(self, t: float) -> int:
        """Switches to the mode."""
        return self._choose(RTL, t)

    def pilot(self, mode: str, t: float) -> bool:
        """A transmitter appears and its switch is turned; sticks centred."""
        for known in MODES:
            if known.name == mode.upper():
                self._transmitter = True
                self._choose(known, t)
                return True
        return False

    # Setpoints.

    def on_trajectory(self, message: Any, t: float) -> None:
        """Frames and masks as PX4's receiver takes them; a wrong one is not even a sign of life."""
        heading = euler_of(attitude_swap(self.flight.attitude_enu)).yaw
        read = read_trajectory(message, heading, self.flight.position_enu[2])
        if isinstance(read, str):
            self.tell(read, t)
        else:
            self._offboard.take(read, t, self.parameters["COM_OF_LOSS_T"])

    def on_attitude(self, message: Any, t: float) -> None:
        """Attitude or body rates, and a thrust."""
        read = read_attitude(message)
        if read is not None:
            self._offboard.take(read, t, self.parameters["COM_OF_LOSS_T"])

    def _offboard_alive(self, t: float) -> bool:
        """Whether a setpoint came lately and what it needs is known."""
        if not self._offboard.fresh(t, self.parameters["COM_OF_LOSS_T"]):
            return False
        return not self._offboard.needs_position or self.position_valid(t)

    def _offboard_ready(self, t: float) -> bool:
        return self._offboard_alive(t) and self._offboard.streamed_s(t) >= STREAM_BEFORE_S
