"""Faults from outside the process: lines on a UDP port of this host, and lines with a time on the command line."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ptnsbc_sim.autopilot.codec import AutopilotError
from ptnsbc_sim.autopilot.faults import obey
from ptnsbc_sim.autopilot.vehicle import StandInVehicle

_HOST = "127.0.0.1"
_LINE_BYTES = 4096


class Timed(NamedTuple):
    """A fault and when it comes, in seconds from the start."""

    at_s: float
    line: str


def parse_timed(text: str) -> Timed:
    """`20 1 gps off`: seconds from the start, then what `obey` takes.

    Raises:
        AutopilotError: it does not begin with a time.
    """
    first, _, line = text.strip().partition(" ")
    try:
        at_s = float(first)
    except ValueError:
        at_s = math.nan
    if not (math.isfinite(at_s) and at_s >= 0.0 and line.strip()):
        raise AutopilotError(
            f'fault "{text}": expected SECONDS SYSTEM FAULT VALUE, as "20 1 gps off"'
        )
    return Timed(at_s, line)


class FaultPort:
    """Obeys lines; call `poll` every tick."""

    def __init__(
        self,
        vehicles: Sequence[StandInVehicle],
        start_t: float,
        *,
        port: int | None = None,
        timed: Sequence[Timed] = (),
        say: Callable[[str], None],
    ) -> None:
        self._vehicles = vehicles
        self._start_t = start_t
        self._port = port
        self._timed = sorted(timed, key=lambda fault: fault.at_s)
        self._say = say
        self._socket: socket.socket | None = None

    def __enter__(self) -> FaultPort:
        if self._port is None:
            return self
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((_HOST, self._port))
        except OSError as error:
            self._socket.close()
            raise AutopilotError(
                f"control port {self._port}: {error.strerror}; expected a free one"
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()

    def poll(self, now: float) -> None:
        """Obey what is due and what has come."""
        while self._timed and now - self._start_t >= self._timed[0].at_s:
            self._say(self._obey(self._timed.pop(0).line, now))
        while self._socket is not None:
            try:
                data, sender = self._socket.recvfrom(_LINE_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            answer = self._obey(data.decode(errors="replace").strip(), now)
            try:
                self._socket.sendto(answer.encode(), sender)
            except OSError:
                continue

    def _obey(self, line: str, now: float) -> str:
        try:
            return obey(self._vehicles, line, now)
        except AutopilotError as error:
            return f"error: {error}"


def ask(port: int, line: str, timeout_s: float = 2.0) -> str:
    """Send a line to a running stand-in's control port; the answer.

    Raises:
        AutopilotError: nobody answers, or the line was refused.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        channel.settimeout(timeout_s)
        try:
            channel.connect((_HOST, port))
            channel.send(line.encode())
            answer = channel.recv(_LINE_BYTES).decode()
        except OSError:
            raise AutopilotError(
                f"control port {port}: no answer; expected a stand-in with --control {port}"
            ) from None
    if answer.startswith("error: "):
        raise AutopilotError(answer.removeprefix("error: "))
    return answer
