"""Commands to the vehicle, and its refusals; a command counts only when the vehicle's state confirms it."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from ptnsbc_io.mavlink.autopilots import Autopilot
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest

_FORCE = 21196.0
"""`param2` of the disarm command that also works in the air: a magic number of MAVLink's own."""

_NO_YAW = math.nan
_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
}
_TRUTH_HZ = {  # a real vehicle refuses it
    "px4": {mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: 50.0},
    "ardupilot": {mavlink.MAVLINK_MSG_ID_SIM_STATE: 50.0},
}


class Commands:
    """COMMAND_LONG messages for one vehicle."""

    def __init__(self, autopilot: Autopilot, sysid: int) -> None:
        self._autopilot = autopilot
        self._sysid = sysid
        self._sent: Counter[int] = Counter()
        self._landings = 0
        self._names: dict[int, str] = {}
        self.refused = ""
        """Newest COMMAND_ACK that was not a plain yes to a named command."""

    def message(self, request: CommandRequest, takeoff_height_m: float) -> Any:
        """The command for a request of the procedure."""
        autopilot = self._autopilot
        match request:
            case CommandRequest.OWN_MODE:  # OFFBOARD of PX4, GUIDED of the others
                if not autopilot.attitude_only:
                    return self._mode(FlightMode.OWN, autopilot.own_mode)
                base = float(mavlink.MAV_MODE_GUIDED_DISARMED)
                return self._long(mavlink.MAV_CMD_DO_SET_MODE, autopilot.own_mode, base)
            case CommandRequest.CHECK:  # not every autopilot knows it
                return self._long(mavlink.MAV_CMD_RUN_PREARM_CHECKS, "")
            case CommandRequest.ARM:  # a PX4 must be in OFFBOARD
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "arm", 1.0)
            case CommandRequest.DISARM:  # on the ground
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "disarm", 0.0, 0.0)
            case CommandRequest.KILL:  # in the air as well
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "disarm", 0.0, _FORCE)
            case CommandRequest.TAKEOFF:  # of vehicles that do not climb by setpoints
                place = (0.0, 0.0, 0.0, _NO_YAW, 0.0, 0.0, takeoff_height_m)
                return self._long(mavlink.MAV_CMD_NAV_TAKEOFF, "take off", *place)
            case CommandRequest.RETURN:
                return self._mode(FlightMode.RETURN, "return")
            case CommandRequest.LAND:
                # By mode and by command in turn: every autopilot understands one of the two.
                self._landings += 1
                if autopilot.attitude_only or self._landings % 2 == 0:
                    return self._long(mavlink.MAV_CMD_NAV_LAND, "land", 0.0, 0.0, 0.0, _NO_YAW)
                return self._mode(FlightMode.LAND, "land")

    def leave_own_mode(self) -> Any:
        """After landing: leave the own mode, in which PX4 would arm at once the next time."""
        return self._mode(FlightMode.HOLD, "hold mode")

    def intervals(self) -> list[Any]:
        """Requests for the messages that the bridge needs; ArduPilot sends none without them."""
        rates_hz = {**_RATES_HZ, **_TRUTH_HZ.get(self._autopilot.name, {})}
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        return [self._long(command, "", float(kind), 1e6 / hz) for kind, hz in rates_hz.items()]

    def request(self, message_id: int) -> Any:
        """The request for one message, once."""
        return self._long(mavlink.MAV_CMD_REQUEST_MESSAGE, "", float(message_id))

    def on_ack(self, message: Any) -> None:
        """COMMAND_ACK."""
        name = self._names.get(message.command, "")
        if not name:
            return
        if message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS):
            self.refused = ""
            return
        results = mavlink.enums["MAV_RESULT"]
        known = message.result in results
        result = results[message.result].name if known else f"result {message.result}"
        self.refused = f"{name}: {result.removeprefix('MAV_RESULT_')}"

    def _mode(self, mode: FlightMode, name: str) -> Any:
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        numbers = map(float, (custom, *self._autopilot.mode_numbers(mode)))
        return self._long(mavlink.MAV_CMD_DO_SET_MODE, name, *numbers)

    def _long(self, command: int, name: str, *parameters: float) -> Any:
        """COMMAND_LONG; an unnamed command is a question, whose refusal is nothing to tell."""
        if name:
            self._names[command] = name
        confirmation = self._sent[command] % 256 if name else 0
        self._sent[command] += 1
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        return mavlink.MAVLink_command_long_message(
            self._sysid, AUTOPILOT_COMPONENT, command, confirmation, *filled
        )
