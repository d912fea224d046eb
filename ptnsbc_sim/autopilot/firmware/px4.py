"""The personality of a PX4 multicopter: what it does by itself, and what it follows. Sources: docs/autopilot.md."""

from __future__ import annotations

from ptnsbc_core.types import Array
from ptnsbc_sim.autopilot.firmware.px4_modes import Px4Modes
from ptnsbc_sim.autopilot.firmware.px4_offboard import LIFT_SHARE_OF_RAMP
from ptnsbc_sim.autopilot.firmware.px4_tables import (
    DESCEND,
    HOLD,
    LAND,
    MANUAL_MODES,
    NEED_POSITION,
    OFFBOARD,
    OFFBOARD_LOSS,
    RTL,
    TAKEOFF,
)
from ptnsbc_sim.autopilot.physics import airframe, targets

_SINK_M_S = 0.7
_SLOW_BELOW_M = 5.0
_FAST_DOWN_M_S = 1.5
_ARRIVED_M = 0.2


class Px4(Px4Modes):
    """PX4 1.16 on a quadrotor without a transmitter."""

    # Rules that act by themselves.

    def watch(self, t: float) -> None:
        """Failsafes, end of take-off, disarming, battery."""
        if not self.armed:
            return
        self._settle_mode(t)
        if self.active == TAKEOFF and self._height - self.flight.position_enu[2] < _ARRIVED_M:
            self._choose(HOLD, t)
        self._watch_ground(t)
        self._watch_battery(t)

    def _settle_mode(self, t: float) -> None:
        """What is flown: what the user wants while it can run, else what the failsafe says."""
        wanted = self.mode
        if wanted == OFFBOARD and not self._offboard_alive(t):
            action = int(self.parameters["COM_OBL_RC_ACT"])
            if action not in OFFBOARD_LOSS:
                self.disarm("offboard signal lost", t)
                return
            wanted = OFFBOARD_LOSS[action]
        if wanted in NEED_POSITION and not self.position_valid(t):
            wanted = DESCEND
        if wanted == self.active:
            return
        if wanted == self.mode:
            self.tell(f"Failsafe cleared: back to {wanted.name}", t)
        else:
            self.tell(f"Failsafe activated: {wanted.name}", t)
        self.active = wanted
        self._place = self._here().ahead(self.flight.velocity_enu)

    def _watch_ground(self, t: float) -> None:
        if self._lift.settle(self.in_contact, self.landed):
            self.log("landed")
        if not self.lifted:
            limit = self.parameters["COM_DISARM_PRFLT"]
            if 0.0 < limit < t - self.armed_t:
                self.disarm("not taken off in time", t)
        elif self.landed:
            limit = self.parameters["COM_DISARM_LAND"]
            if 0.0 < limit < self.flight.standing_s - 1.0:
                self.disarm("landed", t)

    def _watch_battery(self, t: float) -> None:
        charge, before = self.flight.battery, self._warned_charge
        self._warned_charge = charge
        if charge <= self.parameters["BAT_LOW_THR"] < before:
            self.tell("Low battery level, return advised", t)
        if charge <= self.parameters["BAT_CRIT_THR"] < before:
            self.tell("Critical battery level, land now", t)
            if self.parameters["COM_LOW_BAT_ACT"] >= 2.0 and self.in_contact is False:
                self._choose(LAND, t)

    # What the airframe follows.

    def aim(self, t: float) -> Array:
        """Motors off, at idle, ramping up, or the mode's own target."""
        if not self.armed:
            return targets.OFF_TARGET
        if t - self.armed_t < self.parameters["COM_SPOOLUP_TIME"]:
            return targets.IDLE_TARGET
        target = self._mode_target()
        if target[airframe.KIND] != airframe.TRAJECTORY or self._lift.flying:
            return target
        climb = self._offboard.climbs if self.active == OFFBOARD else self.active == TAKEOFF
        lift_s = LIFT_SHARE_OF_RAMP * self.parameters["MPC_TKO_RAMP_T"]
        return self._lift.from_ground(target, climb, self.flight.hover_share, lift_s, t)

    def _mode_target(self) -> Array:
        mode, place = self.active, self._place
        if mode == OFFBOARD:
            return self._offboard.target
        if mode == DESCEND or (mode in MANUAL_MODES and not self._transmitter):
            return targets.sink(_SINK_M_S)
        if mode == LAND:
            return targets.land(place, self._landing_speed())
        if mode == RTL:
            return self._way_home()
        if mode == TAKEOFF:
            climb = self._height - self.flight.position_enu[2]
            return targets.climb(place, min(float(climb), self.parameters["MPC_TKO_SPEED"]))
        return targets.hold(place)

    def _landing_speed(self) -> float:
        above = self.flight.position_enu[2] - self.home_local_enu[2]
        return self.parameters["MPC_LAND_SPEED"] if above < _SLOW_BELOW_M else _FAST_DOWN_M_S

    def _way_home(self) -> Array:
        height = self.home_local_enu[2] + self.parameters["RTL_RETURN_ALT"]
        way = targets.way_home(self.flight.position_enu, self.home_local_enu, height, self._place)
        return targets.land(way, self._landing_speed()) if way.over_home else targets.hold(way)
