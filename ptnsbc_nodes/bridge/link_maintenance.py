"""The needs of a link besides setpoints: heartbeats, time, requests and parameters, each at its own pace."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_io.mavlink.autopilots import (
    Autopilot,
    FlightMode,
    MavlinkParameterError,
    ParameterReader,
    fate,
    refusal,
)
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT, MavlinkLink
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_sim.scenario.mavlink import VehicleLink

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
            case CommandRequest.ARM:  # a PX4 must be in OFFBOARD
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "arm", 1.0)
            case CommandRequest.DISARM:  # on the ground
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "disarm", 0.0, 0.0)
            case CommandRequest.KILL:  # in the air as well
                return self._long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, "disarm", 0.0, _FORCE)
            case CommandRequest.TAKEOFF:  # of vehicles that do not climb by setpoints
                place = (0.0, 0.0, 0.0, _NO_YAW, 0.0, 0.0, takeoff_height_m)
                return self._long(mavlink.MAV_CMD_NAV_TAKEOFF, "take off", *place)
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
        numbers = self._autopilot.mode_numbers(mode)
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        main, sub = float(numbers.main), float(numbers.sub)
        return self._long(mavlink.MAV_CMD_DO_SET_MODE, name, custom, main, sub)

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


_HEARTBEAT_S = 1.0
_TIME_FAST_S, _TIME_SLOW_S = 0.1, 0.5
_FAST_ANSWERS = 10
_REQUEST_S = 1.0
_CONFIRM_S = 0.2  # HEARTBEAT comes once a second, and a pilot must not wait for it
_INTERVALS_S = 5.0
_SILENT_S = 1.0
_MIN_INTERVAL_REQUESTS = 2
_STREAMED_S = 0.1
LINK_MESSAGES = ("TIMESYNC", "PARAM_VALUE", "COMMAND_ACK")


class LinkMaintenance:
    """Keeps the link to one vehicle alive, whatever the flight does."""

    def __init__(self, link: MavlinkLink, settings: VehicleLink, vehicle: VehicleMonitor) -> None:
        self.link = link
        self._settings = settings
        self._vehicle = vehicle
        self.commands = Commands(vehicle.autopilot, settings.sysid)
        self.sync = TimeSync()
        self._parameters = ParameterReader(vehicle.autopilot.parameters, vehicle.autopilot.encoding)
        self.parameters_read = False
        self.urgent = False
        """True if the vehicle's state is asked for more often than it comes: HEARTBEAT comes once a second."""
        self._interval_requests = 0
        self._next_s: dict[str, float] = {}

    @property
    def parameter_refusal(self) -> str:
        """The reason why the vehicle cannot be flown with its parameters; empty while they are unknown or right."""
        if not self.parameters_read:
            return ""
        values, setpoint = self._parameters.values, self._settings.setpoint
        return refusal(self._vehicle.autopilot, values, setpoint) or ""

    @property
    def fate(self) -> str:
        """The behaviour of the vehicle when this bridge is silent."""
        return fate(self._vehicle.autopilot, self._vehicle.mode, self._parameters.values)

    def take_parameters(self, now_s: float) -> Mapping[str, float] | None:
        """The vehicle's parameters once all are read; None before, and at every later call."""
        heard = self._vehicle.heartbeat_s is not None
        if self.parameters_read or not heard or not self._parameters.done(now_s):
            return None
        self.parameters_read = True
        return self._parameters.values

    def ignore_repetitions(self, now_s: float) -> None:
        """Leave out messages that say what others say: PX4 streams both kinds, angles at 100 Hz without being asked."""
        pose = self._vehicle.pose
        ignored = {mavlink.MAVLINK_MSG_ID_ODOMETRY} if pose.leaves_odometry else set()
        if now_s - pose.quaternion_s < _STREAMED_S:
            ignored.add(mavlink.MAVLINK_MSG_ID_ATTITUDE)
        self.link.ignored = frozenset(ignored)

    def on_message(self, message: Any, now_s: float) -> None:
        """TIMESYNC, PARAM_VALUE and COMMAND_ACK; a question of the vehicle is answered."""
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            answer = mavlink.MAVLink_timesync_message(nanoseconds(now_s), message.ts1)
            self.link.send(answer)
        elif kind == "TIMESYNC":
            self.sync.on_answer(message.tc1, message.ts1, now_s)
        elif kind == "PARAM_VALUE":
            try:
                self._parameters.on_param_value(message)
            except MavlinkParameterError as error:
                self._vehicle.warning = str(error)
        elif kind == "COMMAND_ACK":
            self.commands.on_ack(message)

    def _is_due(self, what: str, now_s: float, period_s: float) -> bool:
        if now_s < self._next_s.get(what, now_s):
            return False
        self._next_s[what] = now_s + period_s
        return True

    def send_due(self, now_s: float, healthy: bool, clock_jumped: bool) -> None:
        """Send what is due now: no heartbeat of a companion that failed, and more questions for a clock that jumped."""
        send = self.link.send
        vehicle = self._vehicle
        if healthy and self._is_due("heartbeat", now_s, _HEARTBEAT_S):
            kind, autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            state = mavlink.MAV_STATE_ACTIVE
            send(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, state, 3))
        if vehicle.heartbeat_s is None and not vehicle.unconfirmed:
            return
        fast = clock_jumped or self.sync.answers < _FAST_ANSWERS
        if self._is_due("time", now_s, _TIME_FAST_S if fast else _TIME_SLOW_S):
            send(mavlink.MAVLink_timesync_message(0, self.sync.request(now_s)))
        for name in self._parameters.due(now_s):
            sysid = self._settings.sysid
            send(
                mavlink.MAVLink_param_request_read_message(
                    sysid, AUTOPILOT_COMPONENT, name.encode(), -1
                )
            )
        asking = vehicle.unconfirmed or self.urgent
        if asking and self._is_due("confirmation", now_s, _CONFIRM_S):
            send(self.commands.request(mavlink.MAVLINK_MSG_ID_HEARTBEAT))
        if vehicle.anchor is None and self._is_due("origin", now_s, _REQUEST_S):
            send(self.commands.request(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN))
            send(self.commands.request(mavlink.MAVLINK_MSG_ID_HOME_POSITION))
        position_s = vehicle.pose.position_s
        silent = position_s is None or now_s - position_s > _SILENT_S
        # Single requests may get lost, a rebooted vehicle has forgotten them, and the rates that a vehicle
        # chooses without them are too slow.
        missing = silent or vehicle.landed is None
        wanting = missing or self._interval_requests < _MIN_INTERVAL_REQUESTS
        if wanting and self._is_due("intervals", now_s, _INTERVALS_S):
            self._interval_requests += 1
            for request in self.commands.intervals():
                send(request)
