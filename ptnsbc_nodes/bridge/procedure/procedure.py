"""A flight of one vehicle as a state machine, from the first heartbeat to disarmed.

The procedure is pure: `advance` takes a snapshot of the vehicle and returns what to do; time is a number.
Every step waits for its confirmation, has a time limit, and gives a reason when it fails. The procedure
never sleeps, and never takes a request for its result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ptnsbc_io.mavlink.autopilots import Autopilot, FlightMode
from ptnsbc_nodes.bridge.procedure.steps import (
    LIFTED_M,
    OVER,
    RECOVERED_S,
    STALE_S,
    STOP_S,
    CommandRequest,
    ProcedureOptions,
    ProcedureOutput,
    Step,
    Stream,
    VehicleSnapshot,
)
from ptnsbc_nodes.bridge.procedure.transitions import FlightProgress, advance

_GROUNDED_S = 5.0
_LIMITS_S: Mapping[Step, float] = {
    Step.HEARTBEAT: 120.0,
    Step.PARAMETERS: 20.0,
    Step.STATE: 120.0,
    Step.CONTROLLER: 180.0,
    Step.STREAM: 10.0,
    Step.MODE: 10.0,
    Step.ARM: 20.0,
    Step.ARMED: 8.0,  # most vehicles disarm by themselves after 10 s on the ground
    Step.DISARM: 10.0,
    Step.TAKEOFF: 60.0,
    Step.APART: 60.0,
    Step.LAND: 180.0,
}


_AFTER_LIMIT = {
    Step.TAKEOFF: Step.LAND,
    Step.APART: Step.LAND,
    Step.ARMED: Step.DISARM,
}
_MOTORS_OFF = {Step.KILL: CommandRequest.KILL, Step.DISARM: CommandRequest.DISARM}


class Procedure:
    """The flight of one vehicle; `advance` is called at the rate of the stream."""

    def __init__(
        self,
        autopilot: Autopilot,
        takeoff_height_m: float,
        allow_arming: bool,
        log: Callable[[str], None],
        left_behind: Callable[[], str],
        away_s: float = 0.0,
    ) -> None:
        """`left_behind`: where the armed vehicle is, in which mode, and what it will do without this bridge.

        `away_s`: time for which the vehicle is held while its controller is away, and may come back.
        """
        self._options = ProcedureOptions(autopilot, takeoff_height_m, allow_arming, away_s)
        self._progress = FlightProgress(self._options, log, left_behind)
        self._unprepared = ""
        self.in_pilots_hands = False
        """True if a pilot flies the vehicle, as far as the bridge knows."""
        self.output = ProcedureOutput(Stream.NONE, None, True)
        """The newest result of `advance`."""

    @property
    def step(self) -> Step:
        """The step of the flight in which the vehicle is."""
        return self._progress.step

    @property
    def fault(self) -> str:
        """The reasons why the flight did not go as planned, in the order in which it went wrong."""
        return self._progress.fault

    @property
    def gave_up(self) -> bool:
        """True once this vehicle has given the formation up, so that all others must as well."""
        return self._progress.gave_up

    @property
    def over(self) -> bool:
        """True if there is nothing left to do."""
        return self.step in OVER

    @property
    def ready(self) -> bool:
        """True if the formation may begin, as far as this vehicle is concerned."""
        flies = self.step in (Step.FLY, Step.HELD)
        return flies or (self.step is Step.AIRBORNE and not self._unprepared)

    @property
    def awaited(self) -> str:
        """The reason why the formation waits for this vehicle; empty when it does not."""
        if self.ready:
            return ""
        return self._unprepared if self.step is Step.AIRBORNE else self.step.value

    def fail(self, reason: str) -> None:
        """Record that the bridge itself has failed."""
        self._progress.report_fault(reason)

    def advance(self, snapshot: VehicleSnapshot) -> ProcedureOutput:
        """The actions at `snapshot.now_s`; the step changes as far as the snapshot allows."""
        progress = self._progress
        progress.measure_own_pause(snapshot)
        self._unprepared = snapshot.unprepared
        for _ in Step:  # one snapshot may complete several steps
            if not advance(progress, snapshot):
                break
        limit_s = self._limit_s(snapshot)
        if progress.age_s(snapshot) > limit_s:
            self._expire(snapshot, limit_s)
        stream, command = self._stream_and_command(snapshot)
        due = progress.due(command, snapshot)
        self.in_pilots_hands = progress.in_pilots_hands(snapshot)
        self.output = ProcedureOutput(stream, due, self._in_formation(snapshot))
        return self.output

    def _limit_s(self, snapshot: VehicleSnapshot) -> float:
        """The time limit of this step; there is none while the bridge waits for a pilot."""
        pilot_arms = self.step is Step.ARM and not self._options.allow_arming
        pilot_flies = self.step is Step.MODE and snapshot.armed
        unlimited = pilot_arms or pilot_flies
        return float("inf") if unlimited else _LIMITS_S.get(self.step, float("inf"))

    def _expire(self, snapshot: VehicleSnapshot, limit_s: float) -> None:
        step, options = self.step, self._options
        missing = {
            Step.STATE: snapshot.state_fault,
            Step.CONTROLLER: snapshot.state_fault
            or "no fresh setpoints from a controller that is ready",
            Step.MODE: f"{options.autopilot.own_mode} not confirmed",
            Step.ARM: "arming refused",
            Step.ARMED: f"waiting for {snapshot.not_armed or snapshot.climbs_first}",
            Step.TAKEOFF: f"at {snapshot.height_m:.1f} m of {options.takeoff_height_m:g} m",
        }.get(step, "")
        detail = f": {missing}" if missing else ""
        reason = f"{step.value}: not within {limit_s:g} s{detail}{snapshot.vehicle_reason}"
        following = _AFTER_LIMIT.get(step, Step.FAILED)
        self._progress.enter(following, snapshot, reason)

    def _stream_and_command(
        self, snapshot: VehicleSnapshot
    ) -> tuple[Stream, CommandRequest | None]:
        progress, autopilot, step = self._progress, self._options.autopilot, self.step
        early = Stream.HOLD if autopilot.stream_first else Stream.NONE
        if step in (Step.STREAM, Step.READY, Step.ARMED):
            return early, None
        if step is Step.MODE:
            # Somebody flies a vehicle that is armed already, and only they may change its mode.
            return early, None if snapshot.armed else CommandRequest.OWN_MODE
        if step is Step.ARM:
            may_arm = self._options.allow_arming and not snapshot.armed
            return early, CommandRequest.ARM if may_arm else None
        if step is Step.TAKEOFF:
            if autopilot.climbs:
                return Stream.CLIMB, None
            return Stream.NONE, CommandRequest.TAKEOFF if snapshot.height_m < LIFTED_M else None
        if step is Step.AIRBORNE:
            return (Stream.CLIMB if progress.climbed else Stream.HOLD), None
        if step in (Step.FLY, Step.HELD):
            follows = step is Step.FLY and snapshot.controller_age_s <= STALE_S
            return Stream.PLANNER if follows else Stream.HOLD, None
        if step is Step.LAND:
            return self._landing(snapshot)
        if step is Step.FAILSAFE:
            recovered = progress.good_for_s(snapshot) > RECOVERED_S
            return (Stream.HOLD if recovered else Stream.NONE), None
        return (Stream.APART if step is Step.APART else Stream.NONE), _MOTORS_OFF.get(step)

    def _landing(self, snapshot: VehicleSnapshot) -> tuple[Stream, CommandRequest | None]:
        landed_s = self._progress.current(snapshot).landed_since_s
        if landed_s is not None and snapshot.now_s - landed_s > _GROUNDED_S:
            return Stream.NONE, CommandRequest.DISARM
        if snapshot.mode is FlightMode.LAND:
            return Stream.NONE, None
        # Until the vehicle confirms its landing it still needs setpoints, if there are any.
        fresh = snapshot.controller_age_s <= STOP_S and snapshot.mode is FlightMode.OWN
        return (Stream.HOLD if fresh else Stream.NONE), CommandRequest.LAND

    def _in_formation(self, snapshot: VehicleSnapshot) -> bool:
        if self.step in (Step.YIELDED, Step.KILL, Step.APART, *OVER):
            return False
        return self.step is not Step.LAND or snapshot.leg == "land"
