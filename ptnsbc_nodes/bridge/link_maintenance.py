"""What a link needs besides setpoints: heartbeats, time, requests and parameters, each at its own pace."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ptnsbc_io.mavlink.autopilots import Autopilot
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.parameters import MavlinkParameterError, ParameterReader
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.vehicle import VehicleMonitor

_HEARTBEAT_S = 1.0
_TIME_FAST_S, _TIME_SLOW_S = 0.1, 0.5
_FAST_ANSWERS = 10
_REQUEST_S = 1.0
_CONFIRM_S = 0.2  # HEARTBEAT comes once a second, and a pilot is not to wait for it
_INTERVALS_S = 5.0
_SILENT_S = 1.0
_ASKED_ANYWAY = 2


class _Due:
    """Something that happens again and again."""

    def __init__(self) -> None:
        self._next_s = float("-inf")

    def now(self, now_s: float, period_s: float) -> bool:
        if now_s < self._next_s:
            return False
        self._next_s = now_s + period_s
        return True


class LinkMaintenance:
    """Messages that are due, whatever the flight does."""

    def __init__(
        self,
        autopilot: Autopilot,
        sysid: int,
        commands: Commands,
        vehicle: VehicleMonitor,
        hz: float,
    ) -> None:
        self._sysid = sysid
        self._commands = commands
        self._vehicle = vehicle
        self._state_hz = hz
        self.sync = TimeSync()
        self.parameters = ParameterReader(autopilot.parameters, autopilot.encoding)
        self._asked = 0
        self._heartbeat, self._time, self._origin, self._intervals = (_Due() for _ in range(4))
        self._confirm = _Due()

    def messages(self, now_s: float, healthy: bool, suspicious: bool) -> Iterator[Any]:
        """What to send now.

        Args:
            now_s: steady clock.
            healthy: a companion that has failed sends no heartbeat.
            suspicious: the vehicle's clock does not fit, ask for the time more often.
        """
        if healthy and self._heartbeat.now(now_s, _HEARTBEAT_S):
            yield mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        if self._vehicle.heartbeat_s is None and not self._vehicle.unconfirmed:
            return
        fast = suspicious or self.sync.answers < _FAST_ANSWERS
        if self._time.now(now_s, _TIME_FAST_S if fast else _TIME_SLOW_S):
            yield mavlink.MAVLink_timesync_message(0, self.sync.ask(now_s))
        for name in self.parameters.due(now_s):
            yield mavlink.MAVLink_param_request_read_message(
                self._sysid, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
            )
        yield from self._requests(now_s)

    def _requests(self, now_s: float) -> Iterator[Any]:
        vehicle = self._vehicle
        if vehicle.unconfirmed and self._confirm.now(now_s, _CONFIRM_S):
            yield self._commands.request(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        if vehicle.anchor is None and self._origin.now(now_s, _REQUEST_S):
            yield self._commands.request(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            yield self._commands.request(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        silent = vehicle.pose.position_s is None or now_s - vehicle.pose.position_s > _SILENT_S
        # Requests may get lost one by one, a rebooted vehicle has forgotten them, and what comes
        # unasked comes too slowly.
        asking = silent or vehicle.landed is None or self._asked < _ASKED_ANYWAY
        if asking and self._intervals.now(now_s, _INTERVALS_S):
            self._asked += 1
            yield from self._commands.intervals(self._state_hz)

    def heard(self, message: Any, now_s: float) -> Any:
        """Take in what belongs here; an answer to send, or None."""
        kind = message.get_type()
        if kind == "TIMESYNC":
            if message.tc1 == 0:
                return mavlink.MAVLink_timesync_message(round(now_s * 1e9), message.ts1)
            self.sync.answered(message.tc1, message.ts1, now_s)
        elif kind == "PARAM_VALUE":
            try:
                self.parameters.heard(message)
            except MavlinkParameterError as error:
                self._vehicle.text = str(error)
        elif kind == "COMMAND_ACK":
            self._commands.heard(message)
        return None
