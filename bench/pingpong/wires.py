"""How a process of the reference sends and hears: bytes, or message objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.serialization import deserialize_message

from ptnsbc_io.wire import peek_stamp
from ptnsbc_io.wire.cdr import split_stamp, write_stamp
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.topics import Topic, message_class
from ptnsbc_nodes.uav.controller import UavCounters

Send = Callable[[int], None]


def sender(endpoints: Endpoints, topic: Topic, readers: int, message: bytes) -> Send:
    """Publishes `message` with another stamp each time."""
    publish, buffer = endpoints.publisher(topic, readers), bytearray(message)

    def send(stamp_ns: int) -> None:
        write_stamp(buffer, stamp_ns)
        publish(bytes(buffer))

    return send


def status(name: str) -> bytes:
    """A DiagnosticArray of the size of ours."""
    values = {key: "0.000000" for key in UavCounters().values()}
    return diagnostics(0, f"{name}: planner", DiagnosticLevel.OK, "", values)


class Wires(Protocol):
    """The topics of one process."""

    endpoints: Endpoints

    def sender(self, topic: Topic, readers: int, message: bytes) -> Send:
        """Publishes `message` with another stamp each time."""
        ...

    def listen(self, topic: Topic, on_stamp: Callable[[int], None]) -> None:
        """Hand over the stamp [ns] of every message."""
        ...


class RawWires:
    """Bytes whose stamp is patched and read in place."""

    def __init__(self, node: Node, lockstep: bool) -> None:
        self.endpoints = Endpoints(node, lockstep)

    def sender(self, topic: Topic, readers: int, message: bytes) -> Send:
        """See `Wires`."""
        return sender(self.endpoints, topic, readers, message)

    def listen(self, topic: Topic, on_stamp: Callable[[int], None]) -> None:
        """See `Wires`."""
        self.endpoints.listen(topic, lambda data: on_stamp(peek_stamp(data)))


class _TypedEndpoints(Endpoints):
    """The same topics, and rclpy makes objects of what is heard."""

    def listen(self, topic: Topic, callback: Callable[[Any], None], required: bool = True) -> str:
        subscription = self._node.create_subscription(
            message_class(topic), full_name(self._node, topic), callback, self._profile(topic)
        )
        self._subscriptions.append(subscription)
        if required:
            self._awaited.append(subscription)
        return str(subscription.topic_name)


class TypedWires:
    """Message objects, as the tutorials of rclpy have them."""

    def __init__(self, node: Node, lockstep: bool) -> None:
        self.endpoints = _TypedEndpoints(node, lockstep)

    def sender(self, topic: Topic, readers: int, message: bytes) -> Send:
        """See `Wires`."""
        publish: Any = self.endpoints.publisher(topic, readers)
        made: Any = deserialize_message(message, message_class(topic))
        time = _time_of(made)

        def send(stamp_ns: int) -> None:
            time.sec, time.nanosec = split_stamp(stamp_ns)
            publish(made)

        return send

    def listen(self, topic: Topic, on_stamp: Callable[[int], None]) -> None:
        """See `Wires`."""

        def on_message(message: Any) -> None:
            time = _time_of(message)
            on_stamp(time.sec * 1_000_000_000 + time.nanosec)

        self.endpoints.listen(topic, on_message)


def _time_of(message: Any) -> Any:
    return message.header.stamp if hasattr(message, "header") else message.clock
