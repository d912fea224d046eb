"""The answers of a stand-in to each kind of message; commands are in `commands`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ptnsbc_autopilot import flight_logs
from ptnsbc_autopilot.commands import COMMANDS, mode_request, request_of
from ptnsbc_autopilot.vehicle import Outgoing, StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

Handler = Callable[[StandInVehicle, Any, int, float], None]

UNADDRESSED = ("HEARTBEAT", "PING", "TIMESYNC")
"""Messages for every system, or with an addressee in another form."""


def _heartbeat(vehicle: StandInVehicle, message: Any, link: int, t: float) -> None:
    if message.type == mavlink.MAV_TYPE_GCS:
        vehicle.gcs_heard[link] = t


def _command(vehicle: StandInVehicle, message: Any, link: int, t: float) -> None:
    request = request_of(message)
    command = request.command
    result = mavlink.MAV_RESULT_UNSUPPORTED
    if command in COMMANDS and (vehicle.command_ids is None or command in vehicle.command_ids):
        result = COMMANDS[command](vehicle, request, link, t)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        known = mavlink.enums["MAV_CMD"].get(command)
        name = f"command {command}" if known is None else known.name
        answer = mavlink.enums["MAV_RESULT"][result].name
        vehicle.log(f"{name} from system {request.system}: {answer}")
    ack = mavlink.MAVLink_command_ack_message(
        command, result, 0, 0, request.system, request.component
    )
    # The ack comes before the messages that the command makes it send.
    vehicle.outgoing.insert(0, Outgoing(link, ack))


def _timesync(vehicle: StandInVehicle, message: Any, link: int, t: float) -> None:
    """https://mavlink.io/en/services/timesync.html: tc1 = 0 is a request, ts1 comes back as it was."""
    if message.tc1 == 0:
        vehicle.send(link, mavlink.MAVLink_timesync_message(vehicle.clock.ns(t), message.ts1))


def _ping(vehicle: StandInVehicle, message: Any, link: int, _t: float) -> None:
    if (message.target_system, message.target_component) == (0, 0):
        answer = mavlink.MAVLink_ping_message(
            message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
        )
        vehicle.send(link, answer)


def _param_value(vehicle: StandInVehicle, name: str) -> Any:
    sent = vehicle.parameters.encoded(name)
    return mavlink.MAVLink_param_value_message(name.encode(), *sent)


def _param_request_read(vehicle: StandInVehicle, message: Any, link: int, _t: float) -> None:
    """By name when the index is -1; a parameter that does not exist gets no answer."""
    name: str | None = message.param_id
    if message.param_index >= 0:
        name = vehicle.parameters.name_at(message.param_index)
    if name is not None and name in vehicle.parameters:
        vehicle.send(link, _param_value(vehicle, name))


def _param_request_list(vehicle: StandInVehicle, _message: Any, link: int, _t: float) -> None:
    vehicle.send_slowly(link, [_param_value(vehicle, name) for name in vehicle.parameters])


def _param_set(vehicle: StandInVehicle, message: Any, link: int, _t: float) -> None:
    """PARAM_VALUE has the value after the request, whether or not it was taken."""
    name = message.param_id
    if name not in vehicle.parameters:
        return
    value = vehicle.parameters.decoded(name, message.param_value, message.param_type)
    if value is not None:
        vehicle.set_parameter(name, value)
    vehicle.send(link, _param_value(vehicle, name))


def _set_mode(vehicle: StandInVehicle, message: Any, _link: int, t: float) -> None:
    vehicle.fly(mode_request(message), t)


HANDLERS: dict[str, Handler] = {
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "PARAM_REQUEST_READ": _param_request_read,
    "PARAM_REQUEST_LIST": _param_request_list,
    "PARAM_SET": _param_set,
    "SET_MODE": _set_mode,
    "LOG_REQUEST_LIST": flight_logs.on_request_list,
    "LOG_REQUEST_DATA": flight_logs.on_request_data,
    "LOG_REQUEST_END": flight_logs.on_request_end,
    "SET_POSITION_TARGET_LOCAL_NED": lambda v, message, _, t: v.on_setpoint(message, t),
    "SET_ATTITUDE_TARGET": lambda v, message, _, t: v.on_setpoint(message, t),
}
"""By message name; anything else is ignored."""
