"""What follows from the step of a flight: what the stream carries, which command is due, who is told."""

from __future__ import annotations

from ptnsbc_io.mavlink.autopilots import FlightMode
from ptnsbc_nodes.bridge.procedure.progress import FlightProgress
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

_GROUNDED_S = 5.0


def orders(
    course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot
) -> ProcedureOutput:
    """What to do now."""
    stream, ask = _wanted(course, pilotage, seen)
    return ProcedureOutput(stream, course.due(ask, seen), _told(course, seen))


def _wanted(
    course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot
) -> tuple[Stream, CommandRequest | None]:
    autopilot, step = pilotage.autopilot, course.step
    early = Stream.HOLD if autopilot.stream_first else Stream.NONE
    if step is Step.STREAM:
        return early, None
    if step is Step.MODE:
        # Who is armed already is flown by somebody: the mode is theirs to give.
        return early, None if seen.armed else CommandRequest.OWN_MODE
    if step is Step.ARM:
        return early, CommandRequest.ARM if pilotage.allow_arming and not seen.armed else None
    if step is Step.TAKEOFF:
        if autopilot.climbs:
            return Stream.CLIMB, None
        return Stream.NONE, CommandRequest.TAKEOFF if seen.height_m < LIFTED_M else None
    if step is Step.AIRBORNE:
        return (Stream.CLIMB if course.climbed else Stream.HOLD), None
    if step is Step.FLY:
        fresh = seen.controller_age_s <= STALE_S
        return Stream.PLANNER if fresh else Stream.HOLD, None
    if step is Step.LAND:
        return _landing(course, seen)
    if step is Step.FAILSAFE:
        return (Stream.HOLD if course.good_for(seen) > RECOVERED_S else Stream.NONE), None
    return Stream.NONE, CommandRequest.KILL if step is Step.KILL else None


def _landing(course: FlightProgress, seen: VehicleSnapshot) -> tuple[Stream, CommandRequest | None]:
    if course.grounded_s is not None and seen.now_s - course.grounded_s > _GROUNDED_S:
        return Stream.NONE, CommandRequest.DISARM
    if seen.mode is FlightMode.LAND:
        return Stream.NONE, None
    # Until the vehicle has taken over it still needs setpoints, if it has any.
    fresh = seen.controller_age_s <= STOP_S and seen.mode is FlightMode.OWN
    return (Stream.HOLD if fresh else Stream.NONE), CommandRequest.LAND


def _told(course: FlightProgress, seen: VehicleSnapshot) -> bool:
    if course.step in (Step.YIELDED, Step.KILL, *OVER):
        return False
    return course.step is not Step.LAND or seen.leg == "land"
