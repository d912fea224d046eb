"""Recording over DDS: subscriptions that write into a bag until they are told to end.

Messages are logged at their arrival. /tf is made of odometry where no process publishes it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, Signature
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter, TopicDeclaration, declare
from ptnsbc_io.bag.metadata import has_header
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.door import Door, Refusals, as_bytes
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import Role, Topic
from ptnsbc_nodes.runtime.node_process import BoundedSpin

Derive = Callable[[str, bytes], bytes | None]
"""Makes a message out of the topic and the bytes of another; None when none is due."""

_SLICE_S = 0.1  # Python sees a signal only between two calls of the executor
_QUIET_S = 0.2  # after so long without a message the queues are empty
_FLUSH_CHECK_S = 0.1
_LARGEST = 1 << 30  # bytes of a message: an image or a point cloud of any sensor
OWN_ODOMETRY = re.compile(r"/uav(\d+)/odom")
_LISTS = frozenset({topics.MARKERS.type, topics.TF.type})


class RecorderDoor(Door[bytes]):
    """A door that knows when a message arrived, and counts those that were sent between two that came.

    The middleware notes the time, and a publisher numbers its messages. rclpy gives both to a callback of two
    parameters, and the EventsExecutor of Jazzy gives it both parameters as one tuple.
    """

    __slots__ = ("_newest", "arrived_ns", "lost")
    __signature__ = Signature(
        [Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("data", "info")]
    )

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._newest = self.lost = self.arrived_ns = 0

    def __call__(self, data: Any, info: Any = None) -> None:
        """Record the message, or refuse it."""
        if info is None:
            data, info = data
        newest, self._newest = self._newest, info["publication_sequence_number"] or 0
        if 0 < newest < self._newest:  # else a publisher that was started again
            self.lost += self._newest - newest - 1
        self.arrived_ns = info["received_timestamp"] or time.time_ns()
        super().__call__(data)


class BagRecorder:
    """Subscriptions of a node that write into an open bag."""

    rest_s = 0.05
    """Time for which messages wait in their queues: half of what the queue of the fastest topic holds at 1 kHz."""

    def __init__(self, node: Node, writer: BagWriter, seal: Seal | None = None) -> None:
        self._seal = seal
        self.refusals = Refusals()
        self.received = 0
        self._doors: list[RecorderDoor] = []  # of topics with one publisher
        self._after_each: Callable[[], None] = lambda: None  # called after each message
        self._node = node
        self._writer = writer

    def subscribe(
        self, topic: Topic, name: str, take: Callable[[bytes, int], None], profile: QoSProfile
    ) -> None:
        """Subscribe to the topic under its full name; `take` gets a message and the time of its arrival [ns].

        Raises:
            ImportError, AttributeError: its message type is not installed.
        """
        opened = bytes if self._seal is None else self._seal.opener(topic, lockstep=True)
        status = as_bytes(wire.decode_diagnostics)
        # Every message of a topic belongs into the bag, broken or not, but for statuses: anybody may publish those.
        is_status = topic.type == topics.DIAGNOSTICS.type
        decode = (lambda data: status(opened(data))) if is_status else opened

        def deliver(data: bytes) -> None:
            self.received += 1
            take(data, door.arrived_ns)

        door = RecorderDoor(
            name, decode, deliver, self.refusals, _LARGEST, lambda: self._after_each()
        )
        if topic.role is Role.STATE:
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
    def late(self) -> int:
        """Messages of a lock-step flight that came too late to be sorted in."""
        return 0

    @property
    def lost(self) -> int:
        """States that were sent and did not arrive."""
        return sum(door.lost for door in self._doors)

    def flush_regularly(self) -> None:
        """Write to the disk by wall time."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        flush = self._writer.flush_if_due
        self._node.create_timer(_FLUSH_CHECK_S, lambda: flush(time.monotonic()), clock=steady)

    def on_arrival(
        self, topic: Topic, derived: Sequence[tuple[str, Derive]] = ()
    ) -> Callable[[bytes, int], None]:
        """A callback that writes a message at the time of its arrival, and the topics `derived` of it."""

        def record(data: bytes, arrived_ns: int) -> None:
            stamp_ns = stamp_of(topic, data)
            self._writer.write(topic.name, arrived_ns, data, stamp_ns)
            for name, derive in derived:
                made = derive(topic.name, data)
                if made is not None:
                    self._writer.write(name, arrived_ns, made, stamp_ns)

        return record

    def serve(self, executor: Executor, over: Callable[[], bool], drain_limit_s: float) -> None:
        """Record until it is over, then take in what is still in the queues, for so long at most."""
        slices = BoundedSpin(executor)
        self._after_each = slices.look
        slice_s, behind = 0.0 if self.rest_s else _SLICE_S, False
        while not over():
            if not behind:  # messages come all at once, and do not wake the process one by one
                time.sleep(self.rest_s)
            behind = slices.serve(slice_s, _SLICE_S)
        slices.drain(lambda: self.received, _QUIET_S, drain_limit_s)

    def finish(self) -> None:
        """Write what is still held back; call before the writer is closed."""

    def summary(self, **more: Any) -> Mapping[str, Any]:
        """The outcome of the recording, once the bag is complete."""
        counts = self._writer.counts
        return {
            "bag": str(self._writer.directory),
            "messages": sum(counts.values()),
            "topics": counts,
            **more,
        }


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


def topic_info(topic: Topic, *, lockstep: bool) -> TopicDeclaration:
    """The description of `topic` in a bag: the profile that its publishers offer."""
    offered = qos.profile(topic, lockstep=lockstep)
    return declare(
        topic.name,
        topic.type,
        reliable=offered.reliability == QoSReliabilityPolicy.RELIABLE,
        latched=offered.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL,
        depth=offered.depth,
    )
