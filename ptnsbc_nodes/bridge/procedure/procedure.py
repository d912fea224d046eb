"""A flight of one vehicle as a state machine: from the first heartbeat to disarmed.

Pure: `advance` gets what the bridge has seen at an instant and answers what to do; time is a number.
Every step waits for its confirmation, has a time limit, and a reason when it fails. Nothing is
slept for, nothing is taken for granted because it was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ptnsbc_io.mavlink.autopilots import Autopilot
from ptnsbc_nodes.bridge.procedure.handlers import HANDLERS
from ptnsbc_nodes.bridge.procedure.orders import orders
from ptnsbc_nodes.bridge.procedure.progress import FlightProgress
from ptnsbc_nodes.bridge.procedure.reactions import react
from ptnsbc_nodes.bridge.procedure.steps import (
    OVER,
    ProcedureOptions,
    ProcedureOutput,
    Step,
    VehicleSnapshot,
    because,
)

_LIMITS_S: Mapping[Step, float] = {
    Step.HEARTBEAT: 120.0,
    Step.PARAMETERS: 20.0,
    Step.STATE: 120.0,
    Step.CONTROLLER: 180.0,
    Step.STREAM: 10.0,
    Step.MODE: 10.0,
    Step.ARM: 20.0,
    Step.TAKEOFF: 60.0,
    Step.LAND: 180.0,
    Step.KILL: 10.0,
}


class Procedure:
    """The flight of one vehicle; `advance` is called at the rate of the stream."""

    def __init__(
        self,
        autopilot: Autopilot,
        takeoff_height_m: float,
        allow_arming: bool,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._pilotage = ProcedureOptions(autopilot, takeoff_height_m, allow_arming)
        self._course = FlightProgress(log)
        self._turned = False

    @property
    def step(self) -> Step:
        """Where in the flight the vehicle is."""
        return self._course.step

    @property
    def fault(self) -> str:
        """Why the flight did not go as planned, in the order in which it went wrong."""
        return self._course.fault

    @property
    def over(self) -> bool:
        """Whether there is nothing left to do."""
        return self.step in OVER

    @property
    def ready(self) -> bool:
        """Whether the formation may begin, as far as this vehicle is concerned."""
        return self.step is Step.FLY or (self.step is Step.AIRBORNE and self._turned)

    @property
    def awaited(self) -> str:
        """What keeps the formation waiting for this vehicle; empty when nothing does."""
        if self.ready:
            return ""
        turning = "turning to the formation's heading"
        return turning if self.step is Step.AIRBORNE else self.step.value

    def fail(self, reason: str) -> None:
        """The bridge itself has failed."""
        self._course.blame(reason)

    def advance(self, seen: VehicleSnapshot) -> ProcedureOutput:
        """What to do at `seen.now_s`; changes the step as far as what was seen allows."""
        course = self._course
        course.begin(seen.now_s)
        self._turned = seen.turned
        for _ in Step:  # a step may be over before it began
            before = course.step
            react(course, seen)
            if course.step is before:
                HANDLERS[course.step](course, self._pilotage, seen)
            if course.step is before:
                break
        limit = _LIMITS_S.get(course.step)
        if limit is not None and course.age(seen) > limit and self._limited(seen):
            self._expire(seen, limit)
        return orders(course, self._pilotage, seen)

    def _limited(self, seen: VehicleSnapshot) -> bool:
        """Whether the step's limit counts: a pilot may take as long as it takes."""
        if self.step is Step.ARM:
            return self._pilotage.allow_arming
        return not (self.step is Step.MODE and seen.armed)

    def _expire(self, seen: VehicleSnapshot, limit: float) -> None:
        step = self.step
        waited = {
            Step.STATE: seen.lack,
            Step.CONTROLLER: seen.lack or "no fresh setpoints from a controller that is ready",
            Step.MODE: f"{self._pilotage.autopilot.own_mode} not confirmed",
            Step.ARM: "arming refused",
            Step.TAKEOFF: f"at {seen.height_m:.1f} m of {self._pilotage.takeoff_height_m:g} m",
        }.get(step, "")
        detail = f": {waited}" if waited else ""
        self._course.blame(f"{step.value}: not within {limit:g} s{detail}{because(seen)}")
        self._course.go(Step.LAND if step is Step.TAKEOFF else Step.FAILED, seen)
