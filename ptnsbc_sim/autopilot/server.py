"""Stand-ins on UDP: sockets, the wall clock, and nothing else."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ptnsbc_sim.autopilot.codec import AutopilotError, Codec
from ptnsbc_sim.autopilot.vehicle import COMPANION, IMPOSTOR, Outgoing, StandInVehicle

TICK_HZ = 250
_BUFFER = 65535
_PARTNER_SILENT_S = 5.0
_MOST_PER_TICK = 200  # a flood must not keep the vehicle from flying


class Address(NamedTuple):
    """An IPv4 address."""

    host: str
    port: int


@dataclass
class Endpoint:
    """One UDP socket of one vehicle: where it listens and with whom it talks."""

    listen: Address
    partner: Address | None
    codec: Codec
    socket: socket.socket = field(init=False)
    heard_t: float = -1e9

    def open(self) -> None:
        """Bind.

        Raises:
            AutopilotError: the port is taken.
        """
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        try:
            self.socket.bind(self.listen)
        except OSError as error:
            self.socket.close()
            raise AutopilotError(
                f"udp {self.listen.host}:{self.listen.port}: {error.strerror}; "
                "expected a free port, choose others with --port-base"
            ) from None

    def receive(self, now: float) -> list[Any]:
        """The messages that wait."""
        out: list[Any] = []
        for _ in range(_MOST_PER_TICK):
            try:
                datagram, source = self.socket.recvfrom(_BUFFER)
            except (BlockingIOError, ConnectionRefusedError):
                break
            messages = self.codec.decode(datagram)
            if messages:
                self._meet(Address(*source), now)
            out += messages
        return out

    def _meet(self, source: Address, now: float) -> None:
        """Whoever speaks first is the partner, until silent for long."""
        if source == self.partner:
            self.heard_t = now
        elif now - self.heard_t > _PARTNER_SILENT_S:
            self.partner, self.heard_t = source, now

    def send(self, message: Any) -> None:
        """Send to the partner, if there is one; a full or unreachable network loses it."""
        packet = self.codec.encode(message)
        if self.partner is not None:
            try:
                self.socket.sendto(packet, self.partner)
            except OSError:
                return


@dataclass
class VehicleServer:
    """A vehicle and its links, in the vehicle's order."""

    vehicle: StandInVehicle
    endpoints: Sequence[Endpoint]
    impostor: Endpoint

    @property
    def sockets(self) -> list[Endpoint]:
        """All of them."""
        return [*self.endpoints, self.impostor]

    def exchange(self, now: float) -> None:
        """Take what came in, then step and send."""
        for link, endpoint in enumerate(self.endpoints):
            for message in endpoint.receive(now):
                self._send(self.vehicle.handle(message, link, now))
        self._send(self.vehicle.step(now))

    def _send(self, outgoing: list[Outgoing]) -> None:
        for link, message in outgoing:
            if link == IMPOSTOR:
                self.impostor.partner = self.endpoints[COMPANION].partner
                self.impostor.send(message)
            elif link < len(self.endpoints):
                self.endpoints[link].send(message)


def serve(
    stations: Sequence[VehicleServer],
    stop: Callable[[], bool],
    each: Callable[[float], None] = lambda _now: None,
    ready: Callable[[], None] = lambda: None,
) -> None:
    """Run vehicles by the wall clock until `stop()`; `each(now)` is called every tick, `ready()` once.

    Raises:
        AutopilotError: a port is taken.
    """
    opened: list[Endpoint] = []
    try:
        for station in stations:
            for endpoint in station.sockets:
                endpoint.open()
                opened.append(endpoint)
        ready()
        _loop(stations, stop, each)
    finally:
        for endpoint in opened:
            endpoint.socket.close()


def _loop(
    stations: Sequence[VehicleServer], stop: Callable[[], bool], each: Callable[[float], None]
) -> None:
    period = 1.0 / TICK_HZ
    due = time.monotonic()
    while not stop():
        now = time.monotonic()
        for station in stations:
            station.exchange(now)
        each(now)
        due = max(due + period, now - period)
        wait = due - time.monotonic()
        if wait > 0.0:
            select.select((), (), (), wait)
