"""Transports of MAVLink bytes: UDP in, UDP out, TCP, or a serial port. None of them blocks."""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from ptnsbc_core.errors import PtnsbcError

Address = tuple[str, int]

_DATAGRAM = 65535
_CHUNK = 4096
_BAUD = 921600
_BUFFER = 1 << 20
_EXPECTED = (
    "expected udpin:ADDRESS:PORT (listen there), udpout:ADDRESS:PORT (send there), "
    "tcp:ADDRESS:PORT (a server there) or serial:DEVICE[:BAUD]"
)
_AGAIN_S = 1.0  # a server that is not there is called again
_UNANSWERED_MS = 3000  # then a connection has ended


class ConnectError(PtnsbcError):
    """A link cannot be opened."""


class PortTakenError(ConnectError):
    """Another process listens at the port of a link."""


class Packet(NamedTuple):
    """Received bytes."""

    data: bytes
    sender: Address | None  # None on a serial line


class Transport(ABC):
    """A connection to one vehicle."""

    stream = False
    """True for a stream of bytes, without datagrams."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def fileno(self) -> int:
        """For select()."""
        return int(self._port.fileno())

    @abstractmethod
    def receive(self) -> Packet | None:
        """The bytes that have arrived; None when there are none."""

    @abstractmethod
    def send(self, data: bytes, address: Address | None) -> bool:
        """Send, to `address` where the transport has no fixed address; False when that fails."""

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):
            self._port.close()


class _UdpSocket(Transport):
    """A UDP port that listens for the vehicle, or that sends to one address and receives only from there."""

    def __init__(self, host: str, port: int, *, listens: bool) -> None:
        super().__init__(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self._port.setblocking(False)
        self._port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._peer: Address | None = None if listens else (host, port)
        try:
            if listens:
                self._port.bind((host, port))
            else:
                self._port.connect((host, port))
        except OSError as error:
            self._port.close()
            taken = error.errno == errno.EADDRINUSE
            raise (PortTakenError if taken else ConnectError)(
                f"udpin:{host}:{port}: {error.strerror}: expected a free port of this host; "
                "does another bridge or ground station listen there?"
                if listens
                else f"udpout:{host}:{port}: {error.strerror}: expected an address that can be reached"
            ) from None

    def receive(self) -> Packet | None:
        try:
            data, sender = self._port.recvfrom(_DATAGRAM)
        except OSError:  # nothing has arrived, or an ICMP error of a packet we sent
            return None
        return Packet(data, self._peer or sender)

    def send(self, data: bytes, address: Address | None) -> bool:
        try:
            if self._peer is not None:
                return bool(self._port.send(data) == len(data))
            return address is not None and self._port.sendto(data, address) == len(data)
        except OSError:
            return False


class _TcpClient(Transport):
    """A connection to a server, which is called again when it is not there or has gone."""

    stream = True

    def __init__(self, host: str, port: int) -> None:
        try:
            found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_STREAM)
        except OSError as error:
            raise ConnectError(
                f"tcp:{host}:{port}: {error.strerror}: expected an address that can be reached"
            ) from None
        self._server = found[0][4]
        super().__init__(None)
        self._open(socket.SOCK_STREAM)

    def _open(self, kind: socket.SocketKind) -> None:
        """Call the server by a stream; a datagram socket wakes nobody until it is time to call again."""
        if self._port is not None:
            self.close()
        self._port, self._since_s = socket.socket(socket.AF_INET, kind), time.monotonic()
        self._port.setblocking(False)
        if kind is socket.SOCK_STREAM:
            self._port.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._port.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MS)
            self._port.connect_ex(self._server)

    def receive(self) -> Packet | None:
        lost = self._port.type is socket.SOCK_DGRAM
        if lost and time.monotonic() - self._since_s > _AGAIN_S:
            self._open(socket.SOCK_STREAM)
        try:
            data = self._port.recv(_CHUNK)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._open(socket.SOCK_DGRAM)
        return Packet(data, None) if data else None

    def send(self, data: bytes, address: Address | None) -> bool:
        try:
            return bool(self._port.send(data) == len(data))
        except OSError:
            return False


class _Serial(Transport):
    """A serial line, raw, without flow control."""

    stream = True

    def __init__(self, device: str, baud: int) -> None:
        import serial  # imported only where a serial port is used

        try:
            super().__init__(serial.Serial(device, baud, timeout=0, write_timeout=0))
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise ConnectError(
                f"serial:{device}:{baud}: {error}: expected a serial device that this user may open"
            ) from None

    def receive(self) -> Packet | None:
        try:
            data = self._port.read(_CHUNK)
        except OSError:
            return None
        return Packet(data, None) if data else None

    def send(self, data: bytes, address: Address | None) -> bool:
        try:
            return bool(self._port.write(data) == len(data))
        except OSError:
            return False


def connect(text: str) -> Transport:
    """Open `udpin:0.0.0.0:14540`, `udpout:10.0.0.2:14580`, `tcp:10.0.0.2:5760`, `serial:/dev/ttyACM0:921600`."""
    kind, _, where = text.partition(":")
    if kind == "ros":
        raise ConnectError(
            f"{text}: a vehicle behind topics of ROS 2 is reached by its bridge alone"
        )
    if kind == "serial" and where:
        device, _, baud = where.partition(":")
        if baud and not baud.isdecimal():
            raise ConnectError(f"{text}: baud rate {baud!r}: {_EXPECTED}")
        return _Serial(device, int(baud or _BAUD))
    host, _, port = where.rpartition(":")
    if kind not in ("udpin", "udpout", "tcp") or not host or not port.isdecimal():
        raise ConnectError(f"{text}: {_EXPECTED}")
    if not 0 < int(port) < 65536:
        raise ConnectError(f"{text}: port {port}: expected 1 to 65535")
    if kind == "tcp":
        return _TcpClient(host, int(port))
    return _UdpSocket(host, int(port), listens=kind == "udpin")
