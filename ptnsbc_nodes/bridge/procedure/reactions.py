"""What can happen at any time of a flight, worst first."""

from __future__ import annotations

from ptnsbc_io.mavlink.autopilots import FlightMode
from ptnsbc_nodes.bridge.procedure.progress import FlightProgress
from ptnsbc_nodes.bridge.procedure.steps import (
    BEFORE_ARMING,
    FLYING,
    LIFTED_M,
    OVER,
    SETTING_OUT,
    STOP_S,
    Step,
    VehicleSnapshot,
    because,
)


def react(course: FlightProgress, seen: VehicleSnapshot) -> None:
    """Change the step when something has happened that counts in any of them."""
    if course.step in OVER:
        return
    if seen.halt == "kill" and course.step is not Step.KILL and seen.armed:
        course.blame("stopped by the operator in flight")
        return course.go(Step.KILL, seen)
    if seen.rebooted and course.step not in BEFORE_ARMING:
        course.blame("the vehicle rebooted in flight")
        return course.go(Step.FAILED, seen)
    if seen.twin and course.step in BEFORE_ARMING:
        course.blame("two vehicles with this system id: give each its own")
        return course.go(Step.FAILED, seen)
    if course.step in FLYING:
        return _react_in_flight(course, seen)
    grounded = (seen.battery_low or seen.fence) if course.step in SETTING_OUT else ""
    if grounded and not seen.armed:
        course.blame(f"not armed: {grounded}")
        course.go(Step.FAILED, seen)
    elif course.step in BEFORE_ARMING and seen.halt:
        course.go(Step.LAND if seen.armed else Step.DONE, seen)
    elif course.step is Step.FAILSAFE and (seen.halt or seen.leg == "land"):
        course.go(Step.LAND, seen)


def _react_in_flight(course: FlightProgress, seen: VehicleSnapshot) -> None:
    if not seen.armed:
        if course.step is Step.TAKEOFF and seen.height_m < LIFTED_M:
            course.blame(f"disarmed before it took off{because(seen)}")
        else:
            course.blame("disarmed in flight")
        return course.go(Step.FAILED, seen)
    silent = seen.controller_age_s > STOP_S
    # After a failsafe has ended the last HEARTBEAT of it may still be on its way.
    failsafe_left = seen.mode is FlightMode.HOLD and seen.now_s < course.grace_s
    if seen.mode is not FlightMode.OWN and not silent and not failsafe_left:
        course.blame(f"the pilot took over: mode {seen.mode_name}")
        return course.go(Step.YIELDED, seen)
    if seen.halt or seen.leg == "land":
        return course.go(Step.LAND, seen)
    for reason in (seen.battery_low, seen.fence):
        if reason:
            course.blame(reason)
            return course.go(Step.LAND, seen)
    if silent:
        course.before_failsafe = course.step
        course.blame(f"no setpoints: {seen.lack or 'the controller is silent'}")
        return course.go(Step.FAILSAFE, seen)
    return None
