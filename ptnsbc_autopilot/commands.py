"""COMMAND_LONG and COMMAND_INT: what each command does, and the result in its COMMAND_ACK."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ptnsbc_autopilot.telemetry import BUILDERS, send_message
from ptnsbc_autopilot.vehicle import Request, StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

FORCE = 21196
"""param2 of COMPONENT_ARM_DISARM that overrides the checks.

https://mavlink.io/en/messages/common.html#MAV_CMD_COMPONENT_ARM_DISARM
"""

FLY = (
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
)
"""The commands that change how a vehicle flies."""

_DONE = mavlink.MAV_RESULT_ACCEPTED
_LATER = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
_DENIED = mavlink.MAV_RESULT_DENIED
_FAILED = mavlink.MAV_RESULT_FAILED


def mode_request(message: Any) -> Request:
    """A SET_MODE message as DO_SET_MODE; PX4 packs main and sub mode into one word."""
    word = message.custom_mode
    modes = (word, 0.0) if word < 1 << 16 else ((word >> 16) & 255, word >> 24)
    params = (message.base_mode, *modes, 0.0, 0.0, 0.0, 0.0)
    sender = message.get_srcSystem(), message.get_srcComponent()
    return Request(mavlink.MAV_CMD_DO_SET_MODE, params, *sender)


def request_of(message: Any) -> Request:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    first = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        last = (message.x, message.y, message.z)
    else:
        last = (message.param5, message.param6, message.param7)
    sender = message.get_srcSystem(), message.get_srcComponent()
    return Request(message.command, (*first, *last), *sender)


def whole(value: float) -> int:
    """A number sent as a float; -1 for NaN and infinity."""
    return int(value) if math.isfinite(value) else -1


def custom_mode(request: Request) -> bool:
    """True if a DO_SET_MODE means the autopilot's own modes."""
    base = whole(request.params[0])
    return base > 0 and bool(base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)


def _arm(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    wanted, force = whole(request.params[0]), whole(request.params[1]) == FORCE
    if wanted not in (0, 1):
        return int(_DENIED)
    if wanted == 0:
        flies = not vehicle.in_contact or vehicle.faults.takeoff_detected
        if vehicle.armed and flies and not force:
            vehicle.send_text("Disarming denied: not landed", t)
            return vehicle.refusal
        if vehicle.armed:
            vehicle.disarm("commanded", t)
        return int(_DONE)
    if vehicle.armed:
        return int(_DONE)
    problem = vehicle.arming_problem(t)
    if vehicle.faults.deny_arming:
        problem = "Arming denied by a fault"
    if problem is not None and not force:
        vehicle.send_text(f"{vehicle.refusal_text}: {problem}", t)
        return vehicle.refusal
    vehicle.arm(t)
    return int(_DONE)


def _set_interval(vehicle: StandInVehicle, request: Request, link: int, t: float) -> int:
    message_id = whole(request.params[0])
    if message_id not in BUILDERS:
        return int(_FAILED)
    vehicle.streams[link].set_interval(message_id, request.params[1], t)
    return int(_DONE)


def _run_prearm_checks(vehicle: StandInVehicle, _request: Request, _link: int, t: float) -> int:
    """The checks run all the time: what is asked for is the text."""
    if vehicle.armed:
        return int(_LATER)
    if problem := vehicle.arming_problem(t):
        vehicle.send_text(f"{vehicle.refusal_text}: {problem}", t)
    return int(_DONE)


def _get_interval(vehicle: StandInVehicle, request: Request, link: int, _t: float) -> int:
    message_id = whole(request.params[0])
    interval = vehicle.streams[link].interval_us(message_id)
    vehicle.send(link, mavlink.MAVLink_message_interval_message(message_id, interval))
    return int(_DONE)


def _send(vehicle: StandInVehicle, message_id: int, link: int, t: float) -> int:
    return int(_DONE if send_message(vehicle, message_id, link, t) else _DENIED)


def _set_home(vehicle: StandInVehicle, request: Request, link: int, t: float) -> int:
    """Home is set to the present position only; a stand-in needs no home elsewhere."""
    if whole(request.params[0]) != 1 or not vehicle.position_valid(t):
        return int(_DENIED)
    vehicle.home_local_enu = vehicle.flight.estimate.position_enu.copy()
    send_message(vehicle, mavlink.MAVLINK_MSG_ID_HOME_POSITION, link, t)
    return int(_DONE)


def _reboot(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    if whole(request.params[0]) != 1:
        return int(_DENIED)
    if vehicle.armed:
        return int(_LATER)
    vehicle.reboot_at = t  # in the next step, after the ack
    return int(_DONE)


def _terminate(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    if request.params[0] < 0.5:
        return int(_DENIED)
    if vehicle.armed:
        vehicle.disarm("flight terminated", t)
    return int(_DONE)


Command = Callable[[StandInVehicle, Request, int, float], int]

COMMANDS: dict[int, Command] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _run_prearm_checks,
    **dict.fromkeys(FLY, lambda vehicle, request, _, t: vehicle.fly(request, t)),
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    mavlink.MAV_CMD_REQUEST_MESSAGE: lambda vehicle, request, link, t: _send(
        vehicle, whole(request.params[0]), link, t
    ),
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda vehicle, _, link, t: _send(
        vehicle, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, link, t
    ),
    mavlink.MAV_CMD_GET_HOME_POSITION: lambda vehicle, _, link, t: _send(
        vehicle, mavlink.MAVLINK_MSG_ID_HOME_POSITION, link, t
    ),
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}
"""By command; any other is answered with UNSUPPORTED. A firmware may know fewer: `command_ids`."""
