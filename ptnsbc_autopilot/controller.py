"""A stand-in flight controller in time: `step(t)` moves it, `handle(message, link, t)` answers one message."""

from __future__ import annotations

import math
from typing import Any

from ptnsbc_autopilot.message_handlers import HANDLERS, UNADDRESSED
from ptnsbc_autopilot.telemetry import send_message
from ptnsbc_autopilot.vehicle import IMPOSTOR, Outgoing, StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

_IMPOSTOR_PERIOD_S = 0.2
_IMPOSTOR_OLDER_MS = 90_000


class FlightController(StandInVehicle):
    """The common part of the stand-ins of all firmwares: `px4`, `arducopter` and `stm32` derive from it."""

    _impostor_t = -math.inf

    def step(self, t: float) -> list[Outgoing]:
        """Move to t [s]; returns what is sent without a request."""
        self.flight.advance(t)
        if t >= self.reboot_at:
            self.reboot(t)
        if self.booting(t):
            return []
        if not self.in_contact:
            self.lifted = self.armed
        self.update_mode(t)
        self.flight.target = self.airframe_target(t)
        for link, streams in enumerate(self.streams):
            for message_id in streams.due(t):
                send_message(self, message_id, link, t)
        if self.slow_queue:
            self.outgoing.append(self.slow_queue.popleft())
        if self.faults.duplicate and t >= self._impostor_t:
            self._impostor_t = t + _IMPOSTOR_PERIOD_S
            self._send_as_impostor(t)
        return self._take_outgoing()

    def handle(self, message: Any, link: int, t: float) -> list[Outgoing]:
        """Take one message; returns the answers. Messages for others are ignored."""
        handler = HANDLERS.get(message.get_type())
        if handler is None or self.booting(t) or self.faults.mute or not self._is_for_us(message):
            return []
        handler(self, message, link, t)
        return self._take_outgoing()

    def _take_outgoing(self) -> list[Outgoing]:
        out, self.outgoing = self.outgoing, []
        return [] if self.faults.mute else out

    def _is_for_us(self, message: Any) -> bool:
        if message.get_type() in UNADDRESSED:
            return True
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (0, self.component)

    def _send_as_impostor(self, t: float) -> None:
        """A second sender with our system id: disarmed, 50 m north of our origin, booted long before us."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        heartbeat = mavlink.MAVLink_heartbeat_message(
            self.mav_type, self.autopilot, flags, 0, state, 3
        )
        self.send(IMPOSTOR, heartbeat)
        boot_ms = self.clock.ms(t) + _IMPOSTOR_OLDER_MS
        position = mavlink.MAVLink_local_position_ned_message(boot_ms, 50.0, 0, 0, 0, 0, 0)
        self.send(IMPOSTOR, position)
