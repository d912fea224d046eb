"""What each step of a flight waits for, and which one comes then."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ptnsbc_io.mavlink.autopilots import FlightMode
from ptnsbc_nodes.bridge.procedure.progress import FlightProgress
from ptnsbc_nodes.bridge.procedure.steps import (
    HEARTBEAT_LOST_S,
    RECOVERED_S,
    STALE_S,
    ProcedureOptions,
    Step,
    VehicleSnapshot,
)

_STREAM_S = 1.5  # PX4 wants more than one second of setpoints before OFFBOARD
_MODE_LAG_S = 2.5  # HEARTBEAT comes once a second
_ARRIVED_M = 0.5
_STILL_M_S = 0.5
_SETTLED_S = 1.0
_VERDICT_S = 3.0


def _heartbeat(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if seen.stranger:
        course.blame(seen.stranger)
        course.go(Step.FAILED, seen)
    elif seen.heartbeat_age_s < HEARTBEAT_LOST_S:
        course.go(Step.PARAMETERS, seen)


def _parameters(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if seen.refusal:
        course.blame(seen.refusal)
        course.go(Step.FAILED, seen)
    elif seen.parameters:
        course.go(Step.STATE, seen)


def _state(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if course.lasts(seen.state, seen, _SETTLED_S):
        course.go(Step.CONTROLLER, seen)


def _controller(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    good = seen.state and seen.controller_ready and seen.controller_age_s < STALE_S
    if not seen.state:
        course.go(Step.STATE, seen)
    elif course.lasts(good, seen, _SETTLED_S):
        course.go(Step.STREAM, seen)


def _stream(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if course.lapsed(seen):
        course.go(Step.STATE, seen)
    elif course.age(seen) >= _STREAM_S or not pilotage.autopilot.stream_first:
        course.go(Step.MODE, seen)


def _mode(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if course.lapsed(seen):
        course.go(Step.STATE, seen)
    elif seen.mode is FlightMode.OWN:
        course.go(Step.ARM, seen)


def _arm(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if course.lapsed(seen):
        course.go(Step.STATE, seen)
    elif seen.mode is not FlightMode.OWN:
        course.blame(f"the pilot took over before arming: mode {seen.mode_name}")
        course.go(Step.FAILED, seen)
    elif seen.armed and seen.landed is False:
        course.go(Step.AIRBORNE, seen)  # a pilot flew it up and gave it to us
    elif seen.armed and pilotage.allow_arming:
        course.climbed = True
        course.go(Step.TAKEOFF, seen)


def _takeoff(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    there = (
        abs(seen.height_m - pilotage.takeoff_height_m) < _ARRIVED_M and seen.speed_m_s < _STILL_M_S
    )
    if course.lasts(there, seen, _SETTLED_S):
        course.go(Step.AIRBORNE, seen)


def _airborne(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if seen.leg in ("form", "hold"):
        course.go(Step.FLY, seen)


def _failsafe(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if not seen.armed:
        if course.age(seen) < _VERDICT_S:
            return None  # what became of it, a reboot perhaps, is not heard in one message
        course.blame("landed by its failsafe" if seen.landed else "disarmed in flight")
        return course.go(Step.FAILED, seen)
    if course.age(seen) > _MODE_LAG_S and seen.mode not in (FlightMode.OWN, FlightMode.HOLD):
        # The failsafe lands or returns, or a pilot has it: not ours any more.
        return course.go(Step.YIELDED, seen)
    good = seen.controller_age_s < STALE_S and seen.heartbeat_age_s < HEARTBEAT_LOST_S
    if course.lasts(good, seen, RECOVERED_S):
        _resume(course, seen)
    return None


def _resume(course: FlightProgress, seen: VehicleSnapshot) -> None:
    """Send setpoints again: PX4 then returns to OFFBOARD by itself, unless a pilot took it.

    The mode is never asked for: who switched to Hold in the meantime keeps the vehicle.
    """
    if seen.mode is FlightMode.OWN:
        course.say("setpoints are back, the formation goes on")
        course.grace_s = seen.now_s + _MODE_LAG_S
        course.go(course.before_failsafe, seen)
    elif course.age(seen) > RECOVERED_S + 2 * _MODE_LAG_S and course.good_for(seen) > (
        RECOVERED_S + _MODE_LAG_S
    ):
        course.go(Step.YIELDED, seen)


def _yielded(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if not seen.armed:
        course.go(Step.FAILED, seen)


def _land(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if not seen.armed:
        return course.go(Step.DONE, seen)
    course.confirmed = course.confirmed or seen.mode is FlightMode.LAND
    if seen.mode not in (FlightMode.LAND, FlightMode.OWN) and _taken(course, seen):
        course.blame(f"the pilot took over while landing: mode {seen.mode_name}")
        return course.go(Step.YIELDED, seen)
    if not seen.landed:
        course.grounded_s = None
    elif course.grounded_s is None:
        course.grounded_s = seen.now_s
    return None


def _taken(course: FlightProgress, seen: VehicleSnapshot) -> bool:
    """Whether a mode that is not ours can only be somebody's wish."""
    return course.confirmed or course.age(seen) > 2 * _MODE_LAG_S


def _kill(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    if not seen.armed:
        course.go(Step.FAILED, seen)


def _nothing(course: FlightProgress, pilotage: ProcedureOptions, seen: VehicleSnapshot) -> None:
    """Nothing to wait for; a flight in formation is ended by what `reactions` see."""


HANDLERS: Mapping[Step, Callable[[FlightProgress, ProcedureOptions, VehicleSnapshot], None]] = {
    Step.HEARTBEAT: _heartbeat,
    Step.PARAMETERS: _parameters,
    Step.STATE: _state,
    Step.CONTROLLER: _controller,
    Step.STREAM: _stream,
    Step.MODE: _mode,
    Step.ARM: _arm,
    Step.TAKEOFF: _takeoff,
    Step.AIRBORNE: _airborne,
    Step.FLY: _nothing,
    Step.FAILSAFE: _failsafe,
    Step.YIELDED: _yielded,
    Step.LAND: _land,
    Step.KILL: _kill,
    Step.DONE: _nothing,
    Step.FAILED: _nothing,
}
