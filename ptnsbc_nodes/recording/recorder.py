"""The common part of every recording over DDS: subscriptions that write into a bag until they are told to end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import Parameter, Signature
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.metadata import has_header
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.door import Door, Refusals
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import Role, Topic
from ptnsbc_nodes.runtime.node_process import BoundedSpin, make_executor

Derive = Callable[[str, bytes], bytes | None]
"""Makes a message out of the topic and the bytes of another; None when none is due."""

_SLICE_S = 0.1  # Python sees a signal only between two calls of the executor
_QUIET_S = 0.2  # after so long without a message the queues are empty
_FLUSH_CHECK_S = 0.1
_LARGEST = 1 << 30  # bytes of a message: an image or a point cloud of any sensor
_LISTS = frozenset({topics.MARKERS.type, topics.TF.type})


class NumberedDoor(Door[bytes]):
    """A door that counts the messages that were sent between two that came: a publisher numbers its messages.

    rclpy gives the number to a callback of two parameters, and the EventsExecutor of Jazzy gives it both as one tuple.
    """

    __slots__ = ("_newest", "lost")
    __signature__ = Signature(
        [Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("data", "info")]
    )

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._newest = self.lost = 0

    def __call__(self, data: Any, info: Any = None) -> None:
        """Record the message, or refuse it."""
        if info is None:
            data, info = data
        newest, self._newest = self._newest, info["publication_sequence_number"] or 0
        if 0 < newest < self._newest:  # else a publisher that was started again
            self.lost += self._newest - newest - 1
        super().__call__(data)


class BagRecorder:
    """Subscriptions of a node that write into an open bag."""

    def __init__(self, node: Node, writer: BagWriter, seal: Seal | None = None) -> None:
        self._seal = seal
        self.refusals = Refusals()
        self.received = 0
        self._doors: list[NumberedDoor] = []  # of topics with one publisher
        self.after_each: Callable[[], None] = lambda: None  # called after each message
        self._node = node
        self._writer = writer

    def subscribe(
        self, topic: Topic, name: str, callback: Callable[[bytes], None], profile: QoSProfile
    ) -> None:
        """Subscribe to the topic under its full name.

        Raises:
            ImportError, AttributeError: its message type is not installed.
        """
        # What was on a topic belongs into the bag, broken or not.
        opener = bytes if self._seal is None else self._seal.opener(topic, lockstep=True)
        door = Door(name, opener, callback, self.refusals, _LARGEST)
        if topic.role is Role.STATE:
            door = NumberedDoor(name, opener, callback, self.refusals, _LARGEST)
            self._doors.append(door)
        self._node.create_subscription(
            topics.message_class(topic),
            name,
            door,
            profile,
            raw=True,
            event_callbacks=qos.NO_READER_EVENTS,
        )

    @property
    def lost(self) -> int:
        """States that were sent and did not arrive."""
        return sum(door.lost for door in self._doors)

    def flush_regularly(self) -> None:
        """Write to the disk by wall time."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._node.create_timer(_FLUSH_CHECK_S, self._flush, clock=steady)

    def on_arrival(
        self, topic: Topic, derived: Sequence[tuple[str, Derive]] = ()
    ) -> Callable[[bytes], None]:
        """A callback that writes a message at the time of its arrival.

        Args:
            topic: Of the message.
            derived: Further topics, and what makes their messages out of this one.
        """

        def record(data: bytes) -> None:
            self.received += 1
            # A clock of rclpy says the same, and takes three microseconds more.
            now_ns, stamp_ns = time.time_ns(), stamp_of(topic, data)
            self._writer.write(topic.name, now_ns, data, stamp_ns)
            for name, derive in derived:
                made = derive(topic.name, data)
                if made is not None:
                    self._writer.write(name, now_ns, made, stamp_ns)
            self.after_each()

        return record

    def serve(self, executor: Executor, over: Callable[[], bool], drain_limit_s: float) -> None:
        """Record until it is over, then take in what is still in the queues, for so long at most."""
        slices = BoundedSpin(executor)
        self.after_each = slices.look
        while not over():
            slices.serve(_SLICE_S)
        slices.drain(lambda: self.received, _QUIET_S, drain_limit_s)

    def summary(self, **more: Any) -> Mapping[str, Any]:
        """The outcome of the recording, once the bag is complete."""
        counts = self._writer.counts
        return {
            "bag": str(self._writer.directory),
            "messages": sum(counts.values()),
            "topics": counts,
            **more,
        }

    def _flush(self) -> None:
        self._writer.flush_if_due(time.monotonic())


@contextmanager
def recorder_node(context: Context, name: str) -> Iterator[tuple[Node, Executor]]:
    """A node with nothing but subscriptions, and its executor."""
    node = rclpy.create_node(
        name, context=context, start_parameter_services=False, enable_rosout=False
    )
    executor = make_executor(context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()


def describe(name: str, kind: str, offered: Sequence[QoSProfile]) -> TopicInfo:
    """The description of a topic in a bag, by the weakest profile that its publishers offer."""
    reliable = all(qos.reliability == QoSReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return TopicInfo(
        name,
        kind,
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        max([1, *(qos.depth for qos in offered)]),  # discovery does not tell every depth
    )


def stamp_of(topic: Topic, data: bytes) -> int | None:
    """The header stamp [ns] of a message, of its first element for a list; None without one."""
    listed = topic.type in _LISTS
    if not listed and not has_header(topic.type):
        return None
    try:
        stamp_ns = wire.peek_sequence_stamp(data) if listed else wire.peek_stamp(data)
    except wire.WireError:
        # A broken message of another program was on the topic all the same: the bag has it.
        return None
    return stamp_ns if stamp_ns is not None and stamp_ns >= 0 else None
