"""A flight of one vehicle as a state machine, from the first heartbeat to disarmed.

    HEARTBEAT → PARAMETERS → STATE ⇄ CONTROLLER → STREAM → MODE → CHECKS ⇄ READY → ARM → ARMED
        → TAKEOFF → AIRBORNE → FLY → LAND → DONE

    before arming   → STATE: position or controller lost      → DONE: the operator's stop    → FAILED
    ARM … TAKEOFF   → DISARM: on the ground, and another does not fly, or a stop  → YIELDED: a pilot
    TAKEOFF … FLY   → FAILSAFE: no setpoints  → FLY: they are back  → LAND: nobody takes it over  → YIELDED
                    → APART: a hazard  → LAND                  → LAND: stop, battery, fence   → YIELDED: a pilot
                    → RETURN: told so  → DONE                  → LAND: stop                   → YIELDED: a pilot
    FLY ⇄ HELD      where UAVs come and go: its controller is away
    HEARTBEAT       → FAILSAFE: its bridge has died in flight, and this one takes it over
    any step        → KILL → FAILED

`_STATES` is this diagram: what each step waits for, its time limit, and what follows the limit. `_from_any_step` has
the events that count in more than one step. The procedure is pure: `advance` takes a snapshot of the vehicle and
returns what to do; time is a number. It never sleeps, and never takes a request for its result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from ptnsbc_io.mavlink.autopilots import Autopilot
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import (
    BEFORE_ARMING,
    FLYING,
    HEARTBEAT_LOST_S,
    LIFTED_M,
    OVER,
    RECOVERED_S,
    SETTING_OUT,
    SILENT_KILL_S,
    SILENT_S,
    STALE_S,
    STOP_S,
    CommandRequest,
    Lasting,
    ProcedureOutput,
    Step,
    Stream,
    VehicleSnapshot,
)

_STREAM_S = 1.5  # PX4 wants more than one second of setpoints before OFFBOARD
_MODE_LAG_S = 2.5  # HEARTBEAT comes once a second
_ARRIVED_M = 0.5
_STILL_M_S = 0.5
_SETTLED_S = 1.0
_CHECKED_S = 1.2  # HEARTBEAT and SYS_STATUS come once a second
_APART_S = 5.0  # all are at their heights by then, at 1 m/s
_DISARMED_S = 3.0  # the reason of a disarming, a reboot perhaps, takes several messages to arrive
_GROUNDED_S = 5.0
_PLAIN_S, _LANDED_S, _FORCED_S = 0.5, 1.5, 2.0  # of a vehicle that does not disarm on the ground
_REPEAT_S = 1.0  # an unconfirmed command is sent again after this time
_REPEAT_KILL_S = 0.2


class Transition(NamedTuple):
    """The next step; `reason` is a fault."""

    step: Step
    reason: str = ""


@dataclass
class StepMemory:
    """The observations since the current step began."""

    since_s: float
    good: Lasting = field(default_factory=Lasting)  # what the step waits for
    grounded: Lasting = field(default_factory=Lasting)
    land_mode_seen: bool = False
    requested_s: dict[CommandRequest, float] = field(default_factory=dict)

    def age_s(self, now_s: float) -> float:
        """The time for which this step has lasted."""
        return now_s - self.since_s

    def due(self, command: CommandRequest | None, now_s: float) -> CommandRequest | None:
        """The command when it is to be sent now, for the first time or again."""
        repeat_s = _REPEAT_KILL_S if command is CommandRequest.KILL else _REPEAT_S
        if command is None or now_s - self.requested_s.get(command, -math.inf) < repeat_s:
            return None
        self.requested_s[command] = now_s
        return command


class Procedure:
    """The flight of one vehicle; `advance` is called at the rate of the stream."""

    def __init__(
        self,
        autopilot: Autopilot,
        takeoff_height_m: float,
        allow_arming: bool,
        log: Callable[[str], None],
        away_s: float = 0.0,
    ) -> None:
        """`away_s`: time for which the vehicle is held while its controller is away, and may come back."""
        self.autopilot, self.takeoff_height_m = autopilot, takeoff_height_m
        self.allow_arming, self.away_s, self.log = allow_arming, away_s, log
        self.step = Step.HEARTBEAT
        self.fault = ""
        """The reasons why the flight did not go as planned, in the order in which it went wrong."""
        self.concern = ""
        """Those of them that still count."""
        self.gave_up = False
        """True once this vehicle has given the formation up, even if it lands in the same tick: all others must too."""
        self.in_pilots_hands = False
        self.takes_over = False
        """True if another bridge has died and left the vehicle in flight."""
        self.output = ProcedureOutput(Stream.NONE, None, True)
        self.memory = StepMemory(math.inf)  # the first step begins with the first snapshot
        self.step_before_failsafe = Step.AIRBORNE
        self.climbed = False
        self.hold_tolerated_until_s = -math.inf
        self.stood_still_s = 0.0
        """The time for which this process itself has just stood still."""
        self._highest_m = math.inf  # since it was disarmed; infinite once it is unknown
        self._advanced_s: float | None = None
        self._unprepared = ""

    @property
    def over(self) -> bool:
        """True if there is nothing left to do."""
        return self.step in OVER

    @property
    def stands(self) -> bool:
        """True if the vehicle never left the ground, as far as the bridge has seen all the time."""
        return self._highest_m < LIFTED_M

    @property
    def awaited(self) -> str:
        """The reason why the formation waits for this vehicle; empty when it may begin."""
        if self.step in (Step.FLY, Step.HELD):
            return ""
        return self._unprepared if self.step is Step.AIRBORNE else self.step.value

    def fail(self, reason: str) -> None:
        """Log a fault, also of the bridge itself, and remember it once."""
        self.fault, self.concern = (
            known if reason in known else "; ".join(filter(None, (known, reason)))
            for known in (self.fault, self.concern)
        )
        self.log(reason)

    def advance(self, now: VehicleSnapshot) -> ProcedureOutput:
        """The actions at `now.now_s`; the step changes as far as the snapshot allows."""
        paused_s = 0.0 if self._advanced_s is None else now.now_s - self._advanced_s
        self.stood_still_s = paused_s if paused_s > STOP_S else 0.0
        self._advanced_s, self._unprepared = now.now_s, now.unprepared
        self.memory.since_s = min(self.memory.since_s, now.now_s)
        if now.armed:
            height_m = math.inf if now.state_fault else now.height_m
            self._highest_m = max(self._highest_m, height_m)
        elif now.heartbeat_age_s < HEARTBEAT_LOST_S:
            self._highest_m = 0.0
        for _ in Step:  # one snapshot may complete several steps
            following = _from_any_step(self, now) or _STATES[self.step].following(self, now)
            if following is None:
                break
            self._enter(following, now)
        pilot_arms = self.step is Step.ARM and not self.allow_arming
        pilot_flies = self.step is Step.MODE and now.armed
        limit_s = math.inf if pilot_arms or pilot_flies else _STATES[self.step].limit_s
        if self.memory.age_s(now.now_s) > limit_s:
            missing = {
                Step.STATE: now.state_fault,
                Step.CONTROLLER: now.state_fault
                or "no fresh setpoints from a controller that is ready",
                Step.MODE: f"{self.autopilot.own_mode} not confirmed",
                Step.CHECKS: now.unready,
                Step.ARM: "arming refused",
                Step.ARMED: f"waiting for {now.not_armed or now.climbs_first}",
                Step.TAKEOFF: f"at {now.height_m:.1f} m of {self.takeoff_height_m:g} m",
            }.get(self.step)
            detail = f": {missing}" if missing else ""
            reason = f"{self.step.value}: not within {limit_s:g} s{detail}{now.vehicle_reason}"
            self._enter(Transition(_STATES[self.step].after_limit, reason), now)
        stream, command = _stream_and_command(self, now)
        self.in_pilots_hands = self.flown_by_pilot(now)
        out = self.step in (Step.RETURN, Step.YIELDED, Step.KILL, Step.APART, Step.DISARM, *OVER)
        in_formation = not out and (self.step is not Step.LAND or now.leg == "land")
        self.output = ProcedureOutput(stream, self.memory.due(command, now.now_s), in_formation)
        return self.output

    def _enter(self, following: Transition, now: VehicleSnapshot) -> None:
        step, reason = following
        if now.mode is not FlightMode.OTHER:  # no pilot
            if CommandRequest.ARM in self.memory.requested_s and step in (Step.STATE, *OVER):
                # It may still arm, before it hears anything else.
                lost = f"not taken off: {now.state_fault or 'the controller is silent'}"
                step, reason = Step.DISARM, lost if step is Step.STATE else reason
            elif step in (Step.LAND, Step.YIELDED) and now.armed and self.stands:
                step = Step.DISARM
        if step in OVER and now.armed:
            reason = "; ".join(filter(None, (reason, f"left behind {now.left_behind}")))
        if reason:
            self.fail(reason)
        self.log(f"{step.value}{f': {self.fault}' if step is Step.FAILED else ''}")
        self.step, self.memory = step, StepMemory(now.now_s)
        self.gave_up = self.gave_up or step is Step.APART

    def flown_by_pilot(self, now: VehicleSnapshot) -> bool:
        """True if a pilot flies the vehicle: the bridge has yielded, or found it flown."""
        found = self.step in BEFORE_ARMING and now.armed and now.mode is FlightMode.OTHER
        return self.step is Step.YIELDED or found

    def may_hold(self, now: VehicleSnapshot) -> bool:
        """True if a vehicle whose controller is away may be held, because nothing else is wrong with it."""
        flies = self.step in (Step.FLY, Step.HELD) and self.away_s > 0.0
        return flies and not (now.state_fault or self.stood_still_s)


def _from_any_step(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Events that count in any step, worst first."""
    step, left_alone = flight.step, flight.flown_by_pilot(now) and not now.pilots_too
    stop = "" if left_alone else now.stop_request  # a pilot's vehicle is left alone
    if step in OVER:
        return None
    on_ground = step in (*BEFORE_ARMING, Step.DISARM)
    if stop == "kill" and step is not Step.KILL and (now.armed or not on_ground):
        return Transition(Step.KILL, "motors stopped by the operator")
    coming_down = step in (Step.LAND, Step.KILL) or (step is Step.YIELDED and now.stop_request)
    silent = now.heartbeat_age_s > (SILENT_KILL_S if stop == "kill" else SILENT_S)
    if coming_down and silent and flight.memory.age_s(now.now_s) >= SILENT_S:
        reason = f"{step.value}: the vehicle has been silent for {now.heartbeat_age_s:.0f} s"
        return Transition(Step.FAILED, reason)
    if now.rebooted and step not in BEFORE_ARMING:
        return Transition(Step.FAILED, "the vehicle rebooted in flight")
    if step in FLYING:
        return _in_flight(flight, now)
    if (step is Step.FAILSAFE and (stop or now.lands)) or (
        step in (Step.RETURN, Step.YIELDED) and stop
    ):
        return Transition(Step.LAND)
    return _before_arming(flight, now, stop) if step in BEFORE_ARMING else None


def _before_arming(flight: Procedure, now: VehicleSnapshot, stop: str) -> Transition | None:
    sets_out = flight.step in SETTING_OUT
    if now.duplicate_sysid:
        return Transition(Step.FAILED, "two vehicles with this system id: give each its own")
    if sets_out and not now.armed and (unfit := now.battery_low or now.fence_breach):
        return Transition(Step.FAILED, f"not armed: {unfit}")
    if stop and (math.isfinite(now.heartbeat_age_s) or flight.memory.age_s(now.now_s) > SILENT_S):
        return Transition(Step.LAND if now.armed else Step.DONE)  # once it knows which
    if sets_out and (now.state_fault or now.controller_age_s > STOP_S):
        return Transition(Step.STATE)  # position or controller were lost again
    if flight.step in (Step.CHECKS, Step.READY, Step.ARM) and now.mode is not FlightMode.OWN:
        reason = f"the pilot took over before arming: mode {now.mode_name}"
        return Transition(Step.FAILED, reason)
    return None


def _in_flight(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if not now.armed:
        early = flight.step is Step.TAKEOFF and now.height_m < LIFTED_M
        before = f"disarmed before it took off{now.vehicle_reason}"
        return Transition(Step.FAILED, before if early else "disarmed in flight")
    if now.told_home and now.mode is FlightMode.RETURN:
        return Transition(Step.RETURN, "told to return")
    silent = now.controller_age_s > STOP_S or flight.stood_still_s > 0.0
    silent = silent and not flight.may_hold(now)
    # The last HEARTBEAT of a failsafe may arrive after the failsafe has ended.
    failsafe_ended = now.mode is FlightMode.HOLD and now.now_s < flight.hold_tolerated_until_s
    landing = bool(now.stop_request) and now.mode is FlightMode.LAND  # told past this bridge
    if now.mode is not FlightMode.OWN and not (silent or failsafe_ended or landing):
        return Transition(Step.YIELDED, f"the pilot took over: mode {now.mode_name}")
    if now.stop_request or now.lands:
        return Transition(Step.LAND)
    awaits = flight.step in (Step.TAKEOFF, Step.AIRBORNE) and now.leg is None
    if now.companion_out and awaits and not flight.away_s:
        return Transition(Step.LAND, f"no formation: {now.companion_out}")
    strayed = now.strayed if awaits and flight.climbed else ""
    if unfit := now.battery_low or now.fence_breach or strayed:
        return Transition(Step.LAND, unfit)
    if now.hazard:
        following = Step.LAND if flight.step is Step.TAKEOFF else Step.APART
        return Transition(following, f"formation given up: {now.hazard}")
    if silent:
        flight.step_before_failsafe = flight.step
        why = now.state_fault or "the controller is silent"
        if flight.stood_still_s > 0.0:  # so it has let its state and its setpoints age itself
            stood = f"this bridge stood still for {flight.stood_still_s:.1f} s"
            why = f"{stood}: give its computer less work"
        return Transition(Step.FAILSAFE, f"no setpoints: {why}")
    return None


def _heartbeat(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if now.wrong_vehicle:
        return Transition(Step.FAILED, now.wrong_vehicle)
    if now.heartbeat_age_s >= HEARTBEAT_LOST_S:
        return None
    if not flight.takes_over:
        return Transition(Step.PARAMETERS)
    if not now.armed:  # it must not take off again
        return Transition(Step.FAILED, "it came down while its bridge was dead")
    # It has been without setpoints as behind a bridge that stood still, and comes back in the same way.
    step = {FlightMode.OTHER: Step.YIELDED, FlightMode.LAND: Step.LAND}.get(now.mode, Step.FAILSAFE)
    return Transition(step, "its bridge died, and another one took over")


def _parameters(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if now.parameter_refusal:
        return Transition(Step.FAILED, now.parameter_refusal)
    return Transition(Step.STATE) if now.parameters_read else None


def _state(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    valid_s = flight.memory.good.update(not now.state_fault, now.now_s)
    return Transition(Step.CONTROLLER) if valid_s >= _SETTLED_S else None


def _controller(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if now.state_fault:
        return Transition(Step.STATE)
    if now.controller_absent:
        flight.memory.since_s = now.now_s  # the limit is for a process that is there
    good = now.controller_ready and now.controller_age_s < STALE_S
    settled = flight.memory.good.update(good, now.now_s) >= _SETTLED_S
    return Transition(Step.STREAM) if settled else None


def _stream(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    streamed = flight.memory.age_s(now.now_s) >= _STREAM_S or not flight.autopilot.stream_first
    return Transition(Step.MODE) if streamed else None


def _mode(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    pilot_arms = now.armed or not flight.allow_arming
    if now.mode is not FlightMode.OWN:
        return None
    return Transition(Step.ARM if pilot_arms else Step.CHECKS)


def _checks(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Be ready only when nothing speaks against arming: one that refuses leaves the others with turning rotors."""
    ready_s = flight.memory.good.update(now.armed or not now.unready, now.now_s)
    return Transition(Step.READY) if ready_s >= _CHECKED_S else None


def _ready(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Arm only with gains that fit, where the vehicle may climb, and together with all others."""
    if refusal := now.unfit or now.misplaced or now.companion_out:
        return Transition(Step.FAILED, f"not armed: {refusal}")
    if now.unready and not now.armed:
        return Transition(Step.CHECKS)
    return Transition(Step.ARM) if now.armed or not now.not_ready else None


def _arm(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if now.armed and now.landed is False and now.height_m >= LIFTED_M:
        # A pilot flew it up and handed it over. A flight controller whose motors turn on the ground may say that it
        # has not landed: its height must say so too, or the formation would begin with a vehicle that stands.
        return Transition(Step.AIRBORNE)
    return Transition(Step.ARMED) if now.armed and flight.allow_arming else None


def _armed(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Climb only when all are armed, and after those that stand close."""
    if not now.armed:
        return Transition(Step.FAILED, f"disarmed before it took off{now.vehicle_reason}")
    if now.mode is not FlightMode.OWN:
        return Transition(Step.YIELDED, f"the pilot took over: mode {now.mode_name}")
    if now.companion_out:
        return Transition(Step.DISARM, f"not taken off: {now.companion_out}")
    if now.stop_request or now.lands:
        return Transition(Step.DISARM)
    if now.not_armed or now.climbs_first:
        return None
    flight.climbed = True
    return Transition(Step.TAKEOFF)


def _disarm(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Until it has been disarmed for as long as an order to arm may take to show in HEARTBEAT."""
    disarmed = not now.armed and now.heartbeat_age_s < HEARTBEAT_LOST_S
    if flight.memory.good.update(disarmed, now.now_s) < _MODE_LAG_S:
        return None
    return Transition(Step.FAILED if flight.fault else Step.DONE)


def _takeoff(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    missing_m = abs(now.height_m - flight.takeoff_height_m)
    arrived = missing_m < _ARRIVED_M and now.speed_m_s < _STILL_M_S
    settled = flight.memory.good.update(arrived, now.now_s) >= _SETTLED_S
    return Transition(Step.AIRBORNE) if settled else None


def _airborne(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    unprepared = flight.takes_over and now.unprepared  # the others have begun
    return Transition(Step.FLY) if now.leg in ("form", "hold") and not unprepared else None


def _fly(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    held = now.controller_age_s > STOP_S and flight.may_hold(now)
    return Transition(Step.HELD) if held else None


def _held(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Wait for the controller: it takes its place again, from where the vehicle is held."""
    if now.controller_age_s < STALE_S:  # at once: its way back counts from its first step
        flight.log("its controller is back, the formation goes on")
        return Transition(Step.FLY)
    if flight.memory.age_s(now.now_s) > flight.away_s:
        return Transition(Step.LAND, f"landed after {flight.away_s:g} s without its controller")
    return None


def _apart(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    """Hold at a height that no other vehicle has; then land, the lower ones first."""
    if not now.armed:
        return Transition(Step.FAILED, "disarmed in flight")
    if now.mode is not FlightMode.OWN and not now.stop_request:
        return Transition(Step.YIELDED, f"the pilot took over: mode {now.mode_name}")
    if now.stop_request or now.lands or now.battery_low:
        return Transition(Step.LAND, now.battery_low)
    if now.state_fault:  # it cannot be held by a position that is not known
        return Transition(Step.LAND, now.state_fault)
    settled = flight.memory.good.update(now.apart, now.now_s) >= _APART_S
    return Transition(Step.LAND) if settled and not now.below else None


def _failsafe(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    memory, age_s = flight.memory, flight.memory.age_s(now.now_s)
    if not now.armed:
        reason = "landed by its failsafe" if now.landed else "disarmed in flight"
        return Transition(Step.FAILED, reason) if age_s >= _DISARMED_S else None
    own, heard = now.mode is FlightMode.OWN, now.heartbeat_age_s < HEARTBEAT_LOST_S
    if age_s > _MODE_LAG_S and not own and now.mode is not FlightMode.HOLD:
        # The failsafe lands or returns, or a pilot flies: the bridge has no part in it any more.
        return Transition(Step.YIELDED)
    fresh = now.controller_age_s < STALE_S and heard and now.parameters_read
    recovered = memory.good.update(fresh, now.now_s) >= RECOVERED_S
    if recovered and own:
        # Sent setpoints again, PX4 returns to OFFBOARD by itself. The bridge never requests the mode here: a pilot
        # who switched to Hold in the meantime keeps the vehicle.
        flight.log("setpoints are back, the formation goes on")
        flight.concern = ""
        flight.hold_tolerated_until_s = now.now_s + _MODE_LAG_S
        return Transition(flight.step_before_failsafe)
    if recovered:
        kept = memory.good.seconds(now.now_s) > RECOVERED_S + _MODE_LAG_S
        kept = kept and age_s > RECOVERED_S + 2 * _MODE_LAG_S
        return Transition(Step.YIELDED) if kept else None
    wait_s = _MODE_LAG_S if flight.stands else flight.autopilot.land_s
    if age_s > wait_s and (own or flight.stands) and heard:
        # Nobody has taken it over: its failsafe only waits, as that of an ArduCopter in GUIDED does.
        return Transition(Step.LAND, f"landed after {wait_s:g} s without setpoints")
    return None


def _land(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    memory = flight.memory
    if not now.armed:
        return Transition(Step.DONE)
    memory.land_mode_seen = memory.land_mode_seen or now.mode is FlightMode.LAND
    # Another mode can come from a pilot only once the landing was confirmed, or should have been.
    settled = memory.land_mode_seen or memory.age_s(now.now_s) > 2 * _MODE_LAG_S
    if settled and now.mode not in (FlightMode.LAND, FlightMode.OWN):
        reason = f"the pilot took over while landing: mode {now.mode_name}"
        return Transition(Step.YIELDED, reason)
    memory.grounded.update(bool(now.landed), now.now_s)
    return None


def _return(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    if not now.armed:
        return Transition(Step.DONE)
    if now.mode in (FlightMode.RETURN, FlightMode.LAND):
        return None
    return Transition(Step.YIELDED, f"the pilot took over: mode {now.mode_name}")


def _motors_stop(flight: Procedure, now: VehicleSnapshot) -> Transition | None:
    return None if now.armed else Transition(Step.FAILED)


class State(NamedTuple):
    """One step: what follows it, and for how long it is waited for."""

    following: Callable[[Procedure, VehicleSnapshot], Transition | None]
    limit_s: float = math.inf
    after_limit: Step = Step.FAILED


_STATES: Mapping[Step, State] = {
    Step.HEARTBEAT: State(_heartbeat, 120.0),
    Step.PARAMETERS: State(_parameters, 20.0),
    Step.STATE: State(_state, 120.0),
    Step.CONTROLLER: State(_controller, 180.0),
    Step.STREAM: State(_stream, 10.0),
    Step.MODE: State(_mode, 10.0),
    Step.CHECKS: State(_checks, 30.0),
    Step.READY: State(_ready),
    Step.ARM: State(_arm, 5.0, Step.DISARM),
    Step.ARMED: State(_armed, 8.0, Step.DISARM),  # most disarm by themselves after 10 s
    Step.DISARM: State(_disarm, 10.0),
    Step.TAKEOFF: State(_takeoff, 60.0, Step.LAND),
    Step.AIRBORNE: State(_airborne),
    Step.FLY: State(_fly),
    Step.HELD: State(_held),
    Step.APART: State(_apart, 60.0, Step.LAND),
    Step.FAILSAFE: State(_failsafe),
    Step.RETURN: State(_return),
    Step.YIELDED: State(_motors_stop),
    Step.LAND: State(_land, 180.0),
    Step.KILL: State(_motors_stop),
    Step.DONE: State(lambda flight, now: None),
    Step.FAILED: State(lambda flight, now: None),
}


def _stream_and_command(
    flight: Procedure, now: VehicleSnapshot
) -> tuple[Stream, CommandRequest | None]:
    """The content of the setpoint stream in this step, and the command that it repeats until it is confirmed."""
    step, memory, autopilot = flight.step, flight.memory, flight.autopilot
    if step is Step.TAKEOFF and autopilot.stream_first:
        return Stream.CLIMB, None
    if step is Step.LAND:
        if memory.grounded.seconds(now.now_s) > _GROUNDED_S:
            return Stream.NONE, CommandRequest.DISARM
        if now.mode is FlightMode.LAND:
            return Stream.NONE, None
        # Until the vehicle confirms its landing it still needs setpoints, if there are any.
        fresh = now.controller_age_s <= STOP_S and now.mode is FlightMode.OWN
        return (Stream.HOLD if fresh else Stream.NONE), CommandRequest.LAND
    follows = step is Step.FLY and now.controller_age_s <= STALE_S
    recovered = step is Step.FAILSAFE and memory.good.seconds(now.now_s) > RECOVERED_S
    stream = {
        Step.AIRBORNE: Stream.CLIMB if flight.climbed else Stream.HOLD,
        Step.FLY: Stream.PLANNER if follows else Stream.HOLD,
        Step.HELD: Stream.HOLD,
        Step.APART: Stream.APART,
        Step.FAILSAFE: Stream.HOLD if recovered else Stream.NONE,
    }.get(step, Stream.NONE)
    if step in (*SETTING_OUT, Step.ARMED) and autopilot.stream_first:
        stream = Stream.HOLD
    may_arm = flight.allow_arming and not now.armed
    disarm, age_s = CommandRequest.DISARM, memory.age_s(now.now_s)
    if now.armed and age_s >= _PLAIN_S and now.mode is not FlightMode.OTHER:
        # A PX4 may take the setpoints on the ground for a take-off: then it wants to land first, or to be forced. It is
        # forced only if it never left the ground, as far as the bridge has seen all the time.
        disarm = CommandRequest.LAND if age_s < _LANDED_S else disarm
        if age_s >= _FORCED_S and flight.stands:
            disarm = CommandRequest.KILL
    command = {
        # Somebody flies a vehicle that is armed already, and only they may change its mode.
        Step.MODE: None if now.armed else CommandRequest.OWN_MODE,
        Step.CHECKS: CommandRequest.CHECK,
        Step.ARM: CommandRequest.ARM if may_arm else None,
        Step.DISARM: disarm,
        Step.TAKEOFF: CommandRequest.TAKEOFF if now.height_m < LIFTED_M else None,
        Step.KILL: CommandRequest.KILL,
    }.get(step)
    if now.told_home and step in FLYING:  # it follows its setpoints until its mode has changed
        command = CommandRequest.RETURN
    return stream, command
