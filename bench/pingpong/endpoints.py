"""The publishers and subscribers of the reference, with bytes or message objects, and their common start."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from ptnsbc_io.wire import peek_stamp
from ptnsbc_io.wire.cdr import split_stamp, write_stamp
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.topics import Topic, message_class
from ptnsbc_nodes.uav.controller import UavCounters

READY = "ready"
Send = Callable[[int], None]
"""Publishes a message with this stamp [ns]."""

_POLL_S = 0.05


def when_ready(
    node: Node, endpoints: Endpoints, go: Path | None, begin: Callable[[], None]
) -> None:
    """Print that every topic has both ends; with `go` call `begin` when that file exists."""
    printed = False

    def poll() -> None:
        nonlocal printed
        if not printed and not endpoints.unheard() and not endpoints.unread():
            printed = True
            print(READY, file=sys.stderr, flush=True)
        if printed and (go is None or go.exists()):
            timer.cancel()
            begin()

    timer = node.create_timer(_POLL_S, poll, clock=Clock(clock_type=ClockType.STEADY_TIME))


def status(name: str) -> bytes:
    """A DiagnosticArray of the size of ours."""
    values = {key: "0.000000" for key in UavCounters().values()}
    return diagnostics(0, f"{name}: planner", DiagnosticLevel.OK, "", values)


class RawEndpoints(Endpoints):
    """Topics whose messages are bytes: the stamp is written and read in place."""

    def sender(self, topic: Topic, readers: int, message: bytes) -> Send:
        """Publishes `message` with another stamp each time."""
        publish, buffer = self.publisher(topic, readers), bytearray(message)

        def send(stamp_ns: int) -> None:
            write_stamp(buffer, stamp_ns)
            publish(bytes(buffer))

        return send

    def listen_stamps(self, topic: Topic, on_stamp: Callable[[int], None]) -> None:
        """Call `on_stamp` with the stamp [ns] of every message."""
        self.listen(topic, bytes, lambda data: on_stamp(peek_stamp(data)))


class TypedEndpoints(RawEndpoints):
    """Topics whose messages are objects, as in the tutorials of rclpy."""

    def sender(self, topic: Topic, readers: int, message: bytes) -> Send:
        """Publishes `message` with another stamp each time."""
        publish: Any = self.publisher(topic, readers)
        made: Any = deserialize_message(message, message_class(topic))
        time = _time_of(made)

        def send(stamp_ns: int) -> None:
            time.sec, time.nanosec = split_stamp(stamp_ns)
            publish(made)

        return send

    def listen_stamps(self, topic: Topic, on_stamp: Callable[[int], None]) -> None:
        """Call `on_stamp` with the stamp [ns] of every message."""

        def on_message(message: Any) -> None:
            time = _time_of(message)
            on_stamp(time.sec * 1_000_000_000 + time.nanosec)

        subscription = self._node.create_subscription(
            message_class(topic), full_name(self._node, topic), on_message, self._profile(topic)
        )
        self._subscriptions.append(subscription)
        self._awaited.append(subscription)


def _time_of(message: Any) -> Any:
    return message.header.stamp if hasattr(message, "header") else message.clock
