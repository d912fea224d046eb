"""The transitions of a flight: what can happen in any step, and what each step waits for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from ptnsbc_io.mavlink.autopilots import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import (
    BEFORE_ARMING,
    FLYING,
    HEARTBEAT_LOST_S,
    LAND_S,
    LIFTED_M,
    OVER,
    RECOVERED_S,
    SETTING_OUT,
    SILENT_KILL_S,
    SILENT_S,
    STALE_S,
    STOP_S,
    CommandRequest,
    ProcedureOptions,
    Step,
    VehicleSnapshot,
)

_STREAM_S = 1.5  # PX4 wants more than one second of setpoints before OFFBOARD
_MODE_LAG_S = 2.5  # HEARTBEAT comes once a second
_ARRIVED_M = 0.5
_STILL_M_S = 0.5
_SETTLED_S = 1.0
_APART_S = 5.0  # all are at their heights by then, at 1 m/s
_DISARMED_S = 3.0  # the reason of a disarming, a reboot perhaps, takes several messages to arrive
_REPEAT_S = 1.0  # an unconfirmed command is sent again after this time
_REPEAT_KILL_S = 0.2


@dataclass
class _StepMemory:
    """The observations since the current step began."""

    since_s: float
    good_since_s: float | None = None
    landed_since_s: float | None = None
    land_mode_seen: bool = False
    requested_s: dict[CommandRequest, float] = field(default_factory=dict)


class FlightProgress:
    """The current step of a flight, and what the procedure remembers of the flight so far."""

    def __init__(
        self, options: ProcedureOptions, log: Callable[[str], None], left_behind: Callable[[], str]
    ) -> None:
        self.options = options
        self.log = log
        self._left_behind = left_behind
        self.step = Step.HEARTBEAT
        self.fault = ""
        """The reasons why the flight did not go as planned, in the order in which it went wrong."""
        self.memory: _StepMemory | None = None
        self.gave_up = False
        """True once this vehicle has given the formation up; it stays true whatever follows, even in the same tick."""
        self.step_before_failsafe = Step.AIRBORNE
        self.climbed = False
        self.hold_tolerated_until_s = float("-inf")
        self.stood_still_s = 0.0
        """The time for which this process itself has just stood still."""
        self._advanced_s: float | None = None

    def enter(self, step: Step, snapshot: VehicleSnapshot, reason: str = "") -> None:
        """Begin a step; `reason` is a fault."""
        if step in OVER and snapshot.armed:
            reason = "; ".join(filter(None, (reason, f"left behind {self._left_behind()}")))
        if reason:
            self.report_fault(reason)
        self.log(f"{step.value}{f': {self.fault}' if step is Step.FAILED else ''}")
        self.step = step
        self.gave_up = self.gave_up or step is Step.APART
        self.memory = _StepMemory(snapshot.now_s)

    def report_fault(self, reason: str) -> None:
        """Log a fault, and remember it once."""
        if reason not in self.fault:
            self.fault = "; ".join(filter(None, (self.fault, reason)))
        self.log(reason)

    def measure_own_pause(self, snapshot: VehicleSnapshot) -> None:
        """Note how long ago the procedure was advanced before, unless that is soon enough for the stream."""
        before_s, self._advanced_s = self._advanced_s, snapshot.now_s
        paused_s = 0.0 if before_s is None else snapshot.now_s - before_s
        self.stood_still_s = paused_s if paused_s > STOP_S else 0.0

    def current(self, snapshot: VehicleSnapshot) -> _StepMemory:
        """The memory of this step; the first step begins with the first snapshot."""
        self.memory = self.memory or _StepMemory(snapshot.now_s)
        return self.memory

    def age_s(self, snapshot: VehicleSnapshot) -> float:
        """The time for which this step has lasted."""
        return snapshot.now_s - self.current(snapshot).since_s

    def lasts(self, good: bool, snapshot: VehicleSnapshot, seconds: float) -> bool:
        """True if a condition has been true for this long without a break."""
        memory = self.current(snapshot)
        if not good:
            memory.good_since_s = None
        elif memory.good_since_s is None:
            memory.good_since_s = snapshot.now_s
        return good and self.good_for_s(snapshot) >= seconds

    def good_for_s(self, snapshot: VehicleSnapshot) -> float:
        """The time for which the condition of `lasts` has been true."""
        since_s = self.current(snapshot).good_since_s
        return 0.0 if since_s is None else snapshot.now_s - since_s

    def in_pilots_hands(self, snapshot: VehicleSnapshot) -> bool:
        """True if a pilot flies the vehicle, as far as the bridge knows."""
        return self.step is Step.YIELDED or (self.step in BEFORE_ARMING and snapshot.flown_by_hand)

    def may_hold(self, snapshot: VehicleSnapshot) -> bool:
        """True if a vehicle whose controller is away may be held, because nothing else is wrong with it."""
        flies = self.step in (Step.FLY, Step.HELD) and self.options.away_s > 0.0
        return flies and not (snapshot.state_fault or self.stood_still_s)

    def stop_request(self, snapshot: VehicleSnapshot) -> str:
        """The operator's request as far as it is for this vehicle: a pilot's vehicle is left alone."""
        left_alone = self.in_pilots_hands(snapshot) and not snapshot.pilots_too
        return "" if left_alone else snapshot.stop_request

    def due(
        self, command: CommandRequest | None, snapshot: VehicleSnapshot
    ) -> CommandRequest | None:
        """The command when it is to be sent now, for the first time or again."""
        requested_s = self.current(snapshot).requested_s
        repeat_s = _REPEAT_KILL_S if command is CommandRequest.KILL else _REPEAT_S
        if command is None or snapshot.now_s - requested_s.get(command, float("-inf")) < repeat_s:
            return None
        requested_s[command] = snapshot.now_s
        return command


def advance(progress: FlightProgress, snapshot: VehicleSnapshot) -> bool:
    """Change the step as far as the snapshot demands; returns whether it changed."""
    before = progress.step
    _react(progress, snapshot)
    if progress.step is before:
        _HANDLERS.get(before, _wait)(progress, snapshot)
    return progress.step is not before


def _react(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Events that count in any step, worst first."""
    step, stop = progress.step, progress.stop_request(snapshot)
    if step in OVER:
        return None
    if stop == "kill" and step is not Step.KILL and (snapshot.armed or step not in BEFORE_ARMING):
        return progress.enter(Step.KILL, snapshot, "motors stopped by the operator")
    if _given_up(progress, snapshot, stop):
        return None
    if snapshot.rebooted and step not in BEFORE_ARMING:
        return progress.enter(Step.FAILED, snapshot, "the vehicle rebooted in flight")
    if snapshot.duplicate_sysid and step in BEFORE_ARMING:
        reason = "two vehicles with this system id: give each its own"
        return progress.enter(Step.FAILED, snapshot, reason)
    if step in FLYING:
        return _react_in_flight(progress, snapshot)
    called_down = bool(stop) or snapshot.lands
    if (step is Step.FAILSAFE and called_down) or (step is Step.YIELDED and stop):
        return progress.enter(Step.LAND, snapshot)
    return _react_before_arming(progress, snapshot, stop) if step in BEFORE_ARMING else None


def _react_before_arming(progress: FlightProgress, snapshot: VehicleSnapshot, stop: str) -> None:
    step = progress.step
    unfit = (snapshot.battery_low or snapshot.fence_breach) if step in SETTING_OUT else ""
    if unfit and not snapshot.armed:
        progress.enter(Step.FAILED, snapshot, f"not armed: {unfit}")
    elif stop:
        progress.enter(Step.LAND if snapshot.armed else Step.DONE, snapshot)
    elif step in SETTING_OUT and (snapshot.state_fault or snapshot.controller_age_s > STOP_S):
        progress.enter(Step.STATE, snapshot)  # position or controller were lost again


def _given_up(progress: FlightProgress, snapshot: VehicleSnapshot, stop: str) -> bool:
    """True if the flight has just ended because the vehicle that must come down is silent."""
    step = progress.step
    coming_down = step in (Step.LAND, Step.KILL) or (step is Step.YIELDED and snapshot.stop_request)
    limit_s = SILENT_KILL_S if stop == "kill" else SILENT_S
    if (
        not coming_down
        or snapshot.heartbeat_age_s <= limit_s
        or progress.age_s(snapshot) < SILENT_S
    ):
        return False
    reason = f"{step.value}: the vehicle has been silent for {snapshot.heartbeat_age_s:.0f} s"
    progress.enter(Step.FAILED, snapshot, reason)
    return True


def _react_in_flight(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if not snapshot.armed:
        early = progress.step is Step.TAKEOFF and snapshot.height_m < LIFTED_M
        reason = f"disarmed before it took off{snapshot.vehicle_reason}"
        return progress.enter(Step.FAILED, snapshot, reason if early else "disarmed in flight")
    silent = snapshot.controller_age_s > STOP_S or progress.stood_still_s > 0.0
    silent = silent and not progress.may_hold(snapshot)
    # The last HEARTBEAT of a failsafe may arrive after the failsafe has ended.
    failsafe_ended = (
        snapshot.mode is FlightMode.HOLD and snapshot.now_s < progress.hold_tolerated_until_s
    )
    landing = (
        bool(snapshot.stop_request) and snapshot.mode is FlightMode.LAND
    )  # told past this bridge
    if snapshot.mode is not FlightMode.OWN and not (silent or failsafe_ended or landing):
        reason = f"the pilot took over: mode {snapshot.mode_name}"
        return progress.enter(Step.YIELDED, snapshot, reason)
    if snapshot.stop_request or snapshot.lands:
        return progress.enter(Step.LAND, snapshot)
    if unfit := snapshot.battery_low or snapshot.fence_breach:
        return progress.enter(Step.LAND, snapshot, unfit)
    if snapshot.hazard:
        following = Step.LAND if progress.step is Step.TAKEOFF else Step.APART
        return progress.enter(following, snapshot, f"formation given up: {snapshot.hazard}")
    if silent:
        progress.step_before_failsafe = progress.step
        return progress.enter(
            Step.FAILSAFE, snapshot, f"no setpoints: {_silence(progress, snapshot)}"
        )
    return None


def _silence(progress: FlightProgress, snapshot: VehicleSnapshot) -> str:
    """Why there are no setpoints; a bridge that stood still has let its state and its setpoints age itself."""
    if progress.stood_still_s:
        return f"this bridge stood still for {progress.stood_still_s:.1f} s"
    return snapshot.state_fault or "the controller is silent"


def _heartbeat(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.wrong_vehicle:
        progress.enter(Step.FAILED, snapshot, snapshot.wrong_vehicle)
    elif snapshot.heartbeat_age_s < HEARTBEAT_LOST_S:
        progress.enter(Step.PARAMETERS, snapshot)


def _parameters(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.parameter_refusal:
        progress.enter(Step.FAILED, snapshot, snapshot.parameter_refusal)
    elif snapshot.parameters_read:
        progress.enter(Step.STATE, snapshot)


def _state(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if progress.lasts(not snapshot.state_fault, snapshot, _SETTLED_S):
        progress.enter(Step.CONTROLLER, snapshot)


def _controller(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    good = snapshot.controller_ready and snapshot.controller_age_s < STALE_S
    if snapshot.state_fault:
        progress.enter(Step.STATE, snapshot)
    elif snapshot.controller_held:
        progress.memory = _StepMemory(snapshot.now_s)  # the limit is for a controller that may act
    elif progress.lasts(good, snapshot, _SETTLED_S):
        progress.enter(Step.STREAM, snapshot)


def _stream(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if progress.age_s(snapshot) >= _STREAM_S or not progress.options.autopilot.stream_first:
        progress.enter(Step.MODE, snapshot)


def _mode(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.mode is FlightMode.OWN:
        pilot_arms = snapshot.armed or not progress.options.allow_arming
        progress.enter(Step.ARM if pilot_arms else Step.READY, snapshot)


def _ready(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Arm only with gains that fit, where the vehicle may climb, and together with all others."""
    if refusal := snapshot.unfit or snapshot.misplaced or snapshot.companion_out:
        progress.enter(Step.FAILED, snapshot, f"not armed: {refusal}")
    elif snapshot.mode is not FlightMode.OWN:
        reason = f"the pilot took over before arming: mode {snapshot.mode_name}"
        progress.enter(Step.FAILED, snapshot, reason)
    elif snapshot.armed or not snapshot.not_ready:
        progress.enter(Step.ARM, snapshot)


def _arm(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.mode is not FlightMode.OWN:
        reason = f"the pilot took over before arming: mode {snapshot.mode_name}"
        progress.enter(Step.FAILED, snapshot, reason)
    elif snapshot.armed and snapshot.landed is False:
        progress.enter(Step.AIRBORNE, snapshot)  # a pilot flew it up and handed it over
    elif snapshot.armed and progress.options.allow_arming:
        progress.enter(Step.ARMED, snapshot)


def _armed(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Climb only when all are armed, and after those that stand close."""
    if not snapshot.armed:
        reason = f"disarmed before it took off{snapshot.vehicle_reason}"
        progress.enter(Step.FAILED, snapshot, reason)
    elif snapshot.mode is not FlightMode.OWN:
        reason = f"the pilot took over: mode {snapshot.mode_name}"
        progress.enter(Step.YIELDED, snapshot, reason)
    elif snapshot.companion_out:
        progress.enter(Step.DISARM, snapshot, f"not taken off: {snapshot.companion_out}")
    elif snapshot.stop_request or snapshot.lands:
        progress.enter(Step.DISARM, snapshot)
    elif not (snapshot.not_armed or snapshot.climbs_first):
        progress.climbed = True
        progress.enter(Step.TAKEOFF, snapshot)


def _disarm(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if not snapshot.armed:
        progress.enter(Step.FAILED if progress.fault else Step.DONE, snapshot)


def _takeoff(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    missing_m = abs(snapshot.height_m - progress.options.takeoff_height_m)
    arrived = missing_m < _ARRIVED_M and snapshot.speed_m_s < _STILL_M_S
    if progress.lasts(arrived, snapshot, _SETTLED_S):
        progress.enter(Step.AIRBORNE, snapshot)


def _airborne(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.leg in ("form", "hold"):
        progress.enter(Step.FLY, snapshot)


def _fly(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if snapshot.controller_age_s > STOP_S and progress.may_hold(snapshot):
        progress.enter(Step.HELD, snapshot)


def _held(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Wait for the controller: it takes its place again, from where the vehicle is held."""
    away_s = progress.options.away_s
    if snapshot.controller_age_s < STALE_S:  # at once: its way back counts from its first step
        progress.log("its controller is back, the formation goes on")
        progress.enter(Step.FLY, snapshot)
    elif progress.age_s(snapshot) > away_s:
        progress.enter(Step.LAND, snapshot, f"landed after {away_s:g} s without its controller")


def _apart(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Hold at a height that no other vehicle has; then land, the lower ones first."""
    if not snapshot.armed:
        progress.enter(Step.FAILED, snapshot, "disarmed in flight")
    elif snapshot.mode is not FlightMode.OWN and not snapshot.stop_request:
        reason = f"the pilot took over: mode {snapshot.mode_name}"
        progress.enter(Step.YIELDED, snapshot, reason)
    elif snapshot.stop_request or snapshot.lands or snapshot.battery_low:
        progress.enter(Step.LAND, snapshot, snapshot.battery_low)
    elif snapshot.state_fault:  # it cannot be held by a position that is not known
        progress.enter(Step.LAND, snapshot, snapshot.state_fault)
    elif progress.lasts(snapshot.apart, snapshot, _APART_S) and not snapshot.below:
        progress.enter(Step.LAND, snapshot)


def _failsafe(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    age_s = progress.age_s(snapshot)
    if not snapshot.armed:
        if age_s >= _DISARMED_S:
            reason = "landed by its failsafe" if snapshot.landed else "disarmed in flight"
            progress.enter(Step.FAILED, snapshot, reason)
        return
    if age_s > _MODE_LAG_S and snapshot.mode not in (FlightMode.OWN, FlightMode.HOLD):
        # The failsafe lands or returns, or a pilot flies: the bridge has no part in it any more.
        progress.enter(Step.YIELDED, snapshot)
        return
    good = snapshot.controller_age_s < STALE_S and snapshot.heartbeat_age_s < HEARTBEAT_LOST_S
    if progress.lasts(good, snapshot, RECOVERED_S):
        _resume(progress, snapshot)
    elif (
        age_s > LAND_S
        and snapshot.mode is FlightMode.OWN
        and snapshot.heartbeat_age_s < HEARTBEAT_LOST_S
    ):
        # Nobody has taken it over: its failsafe only waits, as that of an ArduCopter in GUIDED does.
        progress.enter(Step.LAND, snapshot, f"landed after {LAND_S:g} s without setpoints")


def _resume(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Send setpoints again: PX4 then returns to OFFBOARD by itself, unless a pilot took over.

    The bridge never requests the mode here: a pilot who switched to Hold in the meantime keeps the vehicle.
    """
    if snapshot.mode is FlightMode.OWN:
        progress.log("setpoints are back, the formation goes on")
        progress.hold_tolerated_until_s = snapshot.now_s + _MODE_LAG_S
        progress.enter(progress.step_before_failsafe, snapshot)
    elif (
        progress.age_s(snapshot) > RECOVERED_S + 2 * _MODE_LAG_S
        and progress.good_for_s(snapshot) > RECOVERED_S + _MODE_LAG_S
    ):
        progress.enter(Step.YIELDED, snapshot)


def _land(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if not snapshot.armed:
        progress.enter(Step.DONE, snapshot)
        return
    memory = progress.current(snapshot)
    memory.land_mode_seen = memory.land_mode_seen or snapshot.mode is FlightMode.LAND
    # Another mode can come from a pilot only once the landing was confirmed, or should have been.
    settled = memory.land_mode_seen or progress.age_s(snapshot) > 2 * _MODE_LAG_S
    if settled and snapshot.mode not in (FlightMode.LAND, FlightMode.OWN):
        reason = f"the pilot took over while landing: mode {snapshot.mode_name}"
        progress.enter(Step.YIELDED, snapshot, reason)
    elif not snapshot.landed:
        memory.landed_since_s = None
    elif memory.landed_since_s is None:
        memory.landed_since_s = snapshot.now_s


def _wait_for_disarming(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    if not snapshot.armed:
        progress.enter(Step.FAILED, snapshot)


def _wait(progress: FlightProgress, snapshot: VehicleSnapshot) -> None:
    """Wait for nothing: nothing follows a flight."""


_HANDLERS: Mapping[Step, Callable[[FlightProgress, VehicleSnapshot], None]] = {
    Step.HEARTBEAT: _heartbeat,
    Step.PARAMETERS: _parameters,
    Step.STATE: _state,
    Step.CONTROLLER: _controller,
    Step.STREAM: _stream,
    Step.MODE: _mode,
    Step.READY: _ready,
    Step.ARM: _arm,
    Step.ARMED: _armed,
    Step.DISARM: _disarm,
    Step.TAKEOFF: _takeoff,
    Step.AIRBORNE: _airborne,
    Step.FLY: _fly,
    Step.HELD: _held,
    Step.APART: _apart,
    Step.FAILSAFE: _failsafe,
    Step.YIELDED: _wait_for_disarming,
    Step.LAND: _land,
    Step.KILL: _wait_for_disarming,
}
