"""The needs of a link besides setpoints: heartbeats, time, requests and parameters, each at its own pace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_io.mavlink.autopilots import MavlinkParameterError, ParameterReader, fate, refusal
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT, MavlinkLink, companion_heartbeat
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_sim.scenario.mavlink import VehicleLink

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
        autopilot = vehicle.autopilot
        self._parameters = ParameterReader(autopilot.parameters, bytewise=autopilot.bytewise)
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
            send(companion_heartbeat())
        if vehicle.heartbeat_s is None and not vehicle.unconfirmed:
            return
        fast = clock_jumped or self.sync.answers < _FAST_ANSWERS
        if self._is_due("time", now_s, _TIME_FAST_S if fast else _TIME_SLOW_S):
            send(mavlink.MAVLink_timesync_message(0, self.sync.request(now_s)))
        read, sysid = mavlink.MAVLink_param_request_read_message, self._settings.sysid
        for name in () if self.parameters_read else self._parameters.due(now_s):
            send(read(sysid, AUTOPILOT_COMPONENT, name.encode(), -1))
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
