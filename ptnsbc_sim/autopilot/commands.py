"""COMMAND_LONG and COMMAND_INT: what each command does and what COMMAND_ACK says of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from ptnsbc_io.mavlink.dialect import mavlink

if TYPE_CHECKING:
    from ptnsbc_sim.autopilot.vehicle import StandInVehicle

FORCE = 21196
"""param2 of COMPONENT_ARM_DISARM that overrides the checks.

https://mavlink.io/en/messages/common.html#MAV_CMD_COMPONENT_ARM_DISARM
"""

_DONE = mavlink.MAV_RESULT_ACCEPTED
_LATER = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
_DENIED = mavlink.MAV_RESULT_DENIED
_FAILED = mavlink.MAV_RESULT_FAILED


class Request(NamedTuple):
    """A command, whichever message brought it."""

    command: int
    params: tuple[float, ...]  # (7,)
    system: int  # who asks
    component: int

    @classmethod
    def old_mode(cls, message: Any) -> Request:
        """A SET_MODE message as DO_SET_MODE; PX4 packs main and sub mode into one word."""
        word = message.custom_mode
        params = (message.base_mode, word, 0.0, 0.0, 0.0, 0.0, 0.0)
        if word >= 1 << 16:
            params = (message.base_mode, (word >> 16) & 255, word >> 24, 0.0, 0.0, 0.0, 0.0)
        return cls(
            mavlink.MAV_CMD_DO_SET_MODE,
            params,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )


def request_of(message: Any) -> Request:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    first = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        last = (message.x, message.y, message.z)
    else:
        last = (message.param5, message.param6, message.param7)
    return Request(
        message.command, (*first, *last), message.get_srcSystem(), message.get_srcComponent()
    )


def whole(value: float) -> int:
    """A number sent as a float; -1 for NaN and infinity."""
    return int(value) if math.isfinite(value) else -1


def custom_mode(request: Request) -> bool:
    """Whether a DO_SET_MODE means the autopilot's own modes."""
    base = whole(request.params[0])
    return base > 0 and bool(base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)


def _arm(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    wanted, force = whole(request.params[0]), whole(request.params[1]) == FORCE
    if wanted not in (0, 1):
        return int(_DENIED)
    if wanted == 0:
        if vehicle.armed and not vehicle.in_contact and not force:
            vehicle.tell("Disarming denied: not landed", t)
            return vehicle.refusal
        if vehicle.armed:
            vehicle.disarm("commanded", t)
        return int(_DONE)
    if vehicle.armed:
        return int(_DONE)
    problem = vehicle.arming_problem(t)
    if problem is not None and not force:
        vehicle.tell(vehicle.refusal_text(problem), t)
        return vehicle.refusal
    vehicle.arm(t)
    return int(_DONE)


def _set_mode(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    return vehicle.set_mode(request, t)


def _take_off(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    return vehicle.take_off(request, t)


def _land(vehicle: StandInVehicle, _request: Request, _link: int, t: float) -> int:
    return vehicle.land(t)


def _return(vehicle: StandInVehicle, _request: Request, _link: int, t: float) -> int:
    return vehicle.return_home(t)


def _interval(vehicle: StandInVehicle, request: Request, link: int, t: float) -> int:
    known = vehicle.set_interval(whole(request.params[0]), request.params[1], link, t)
    return int(_DONE if known else _FAILED)


def _get_interval(vehicle: StandInVehicle, request: Request, link: int, _t: float) -> int:
    message_id = whole(request.params[0])
    interval = vehicle.interval_us(message_id, link)
    vehicle.send(link, mavlink.MAVLink_message_interval_message(message_id, interval))
    return int(_DONE)


def _message(vehicle: StandInVehicle, request: Request, link: int, t: float) -> int:
    sent = vehicle.request_message(whole(request.params[0]), link, t)
    return int(_DONE if sent else _DENIED)


def _version(vehicle: StandInVehicle, _request: Request, link: int, t: float) -> int:
    sent = vehicle.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, link, t)
    return int(_DONE if sent else _DENIED)


def _get_home(vehicle: StandInVehicle, _request: Request, link: int, t: float) -> int:
    sent = vehicle.request_message(mavlink.MAVLINK_MSG_ID_HOME_POSITION, link, t)
    return int(_DONE if sent else _DENIED)


def _set_home(vehicle: StandInVehicle, request: Request, link: int, t: float) -> int:
    """Here only: a home elsewhere is of no use to a stand-in."""
    if whole(request.params[0]) != 1 or not vehicle.position_valid(t):
        return int(_DENIED)
    vehicle.home_local_enu = vehicle.flight.position_enu.copy()
    vehicle.request_message(mavlink.MAVLINK_MSG_ID_HOME_POSITION, link, t)
    return int(_DONE)


def _reboot(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    if whole(request.params[0]) != 1:
        return int(_DENIED)
    if vehicle.armed:
        return int(_LATER)
    vehicle.reboot_soon(t)
    return int(_DONE)


def _terminate(vehicle: StandInVehicle, request: Request, _link: int, t: float) -> int:
    if request.params[0] < 0.5:
        return int(_DENIED)
    if vehicle.armed:
        vehicle.disarm("flight terminated", t)
    return int(_DONE)


Run = Callable[["StandInVehicle", Request, int, float], int]

COMMANDS: dict[int, Run] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    mavlink.MAV_CMD_REQUEST_MESSAGE: _message,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _version,
    mavlink.MAV_CMD_GET_HOME_POSITION: _get_home,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
}
"""What is understood; anything else is answered with UNSUPPORTED. A personality may leave some out."""
