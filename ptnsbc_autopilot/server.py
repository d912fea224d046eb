"""Stand-ins on UDP: MAVLink bytes, sockets and the wall clock."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ptnsbc_autopilot.controller import FlightController
from ptnsbc_autopilot.vehicle import COMPANION, IMPOSTOR, AutopilotError, Outgoing
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import timestamp_now

TICK_HZ = 250
_BUFFER = 65535
_PARTNER_TIMEOUT_S = 5.0
_MOST_PER_TICK = 200  # datagrams; a flood must not delay the physics


class Codec:
    """MAVLink 2 bytes of one vehicle on one link, signed when there is a key."""

    def __init__(
        self, system: int, component: int = 1, *, key: bytes | None = None, link_id: int = 0
    ) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._mavlink.robust_parsing = True
        self.dropped = 0
        if key is not None:
            signing = self._mavlink.signing
            signing.secret_key = key
            signing.sign_outgoing = True
            signing.link_id = link_id
            signing.timestamp = timestamp_now()

    def encode(self, message: Any) -> bytes:
        """One packet."""
        packet = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return packet

    def decode(self, datagram: bytes) -> list[Any]:
        """The messages in a datagram; broken, unknown and wrongly signed ones are only counted."""
        out = []
        for message in self._mavlink.parse_buffer(datagram) or ():
            if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
                self.dropped += 1
            else:
                out.append(message)
        return out


class Address(NamedTuple):
    """An IPv4 address."""

    host: str
    port: int


@dataclass
class Endpoint:
    """One UDP socket of one vehicle: the address it listens on, and its partner."""

    listen: Address
    partner: Address | None
    codec: Codec
    socket: socket.socket = field(init=False)
    last_heard_t: float = -1e9

    def __post_init__(self) -> None:
        self._first = self.partner

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
        """The messages that have arrived."""
        out: list[Any] = []
        for _ in range(_MOST_PER_TICK):
            try:
                datagram, source = self.socket.recvfrom(_BUFFER)
            except (BlockingIOError, ConnectionRefusedError):
                break
            messages = self.codec.decode(datagram)
            if messages:
                self._update_partner(Address(*source), now)
            out += messages
        if now - self.last_heard_t > _PARTNER_TIMEOUT_S:  # as a firmware that has its address
            self.partner = self._first or self.partner
        return out

    def _update_partner(self, source: Address, now: float) -> None:
        """The first sender is the partner, until it is silent for 5 s."""
        if source == self.partner:
            self.last_heard_t = now
        elif now - self.last_heard_t > _PARTNER_TIMEOUT_S:
            self.partner, self.last_heard_t = source, now

    def send(self, message: Any) -> None:
        """Send to the partner, if there is one; the message is lost when the network is full or unreachable."""
        packet = self.codec.encode(message)
        if self.partner is not None:
            try:
                self.socket.sendto(packet, self.partner)
            except OSError:
                return


@dataclass
class VehicleServer:
    """A vehicle and its links, in the vehicle's order."""

    vehicle: FlightController
    endpoints: Sequence[Endpoint]
    impostor: Endpoint

    @property
    def sockets(self) -> list[Endpoint]:
        """The sockets of all links."""
        return [*self.endpoints, self.impostor]

    def exchange(self, now: float) -> None:
        """Handle the messages that came in, then step and send."""
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
