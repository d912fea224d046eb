"""Recording over DDS: subscriptions that write into a bag until they are told to end, and a recording beside any fleet.

`record` finds topics that are not known in advance. Each topic is subscribed to with what its publishers offer, at once
or when it appears. Messages are logged at their arrival. /tf is made of odometry where no process publishes it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from inspect import Parameter, Signature
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, BagWriter, TopicDeclaration, declare
from ptnsbc_io.bag.metadata import has_header
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.agent_messages import Transforms
from ptnsbc_nodes.comm.door import Door, Refusals, as_bytes
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import Role, Topic
from ptnsbc_nodes.runtime.node_process import BoundedSpin, plain_node
from ptnsbc_nodes.runtime.signals import StopRequest

Derive = Callable[[str, bytes], bytes | None]
"""Makes a message out of the topic and the bytes of another; None when none is due."""

_SLICE_S = 0.1  # Python sees a signal only between two calls of the executor
_QUIET_S = 0.2  # after so long without a message the queues are empty
_FLUSH_CHECK_S = 0.1
_LARGEST = 1 << 30  # bytes of a message: an image or a point cloud of any sensor
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


def describe(name: str, kind: str, offered: Sequence[QoSProfile]) -> TopicDeclaration:
    """The description of a topic in a bag, by the weakest profile that its publishers offer."""
    return declare(
        name,
        kind,
        reliable=all(qos.reliability == QoSReliabilityPolicy.RELIABLE for qos in offered),
        latched=all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered),
        depth=max([1, *(qos.depth for qos in offered)]),  # discovery does not tell every depth
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


def topic_info(topic: Topic, *, lockstep: bool) -> TopicDeclaration:
    """The description of `topic` in a bag: the profile that its publishers offer."""
    return describe(topic.name, topic.type, [qos.profile(topic, lockstep=lockstep)])


OURS = tuple(
    topic.name.replace("/uav0/", "/uav*/")
    for topic in topics.in_bag(
        [0], lockstep=False, with_truth=True, with_slots=True, with_stream=True
    )
)
"""Topics of a flight, as patterns."""
_LOOK_S = 0.5  # between two looks for new topics
_QUEUE = 1000
_DRAIN_LIMIT_S = 2.0  # a fleet that flies on has no last message
OWN_ODOMETRY = re.compile(r"/uav(\d+)/odom")


def record(
    writer: BagWriter,
    patterns: Sequence[str],
    say: Callable[[str], None],
    duration_s: float | None = None,
) -> Mapping[str, Any]:
    """Record topics of these names into a bag until the time is over or a signal comes; returns what was recorded.

    Raises:
        BagError: the bag cannot be written.
        PtnsbcError: not one message came.
    """
    with StopRequest() as stop, plain_node("record") as (node, executor):
        with writer:
            recorder = TopicRecorder(node, writer, patterns, say)
            say("ready")
            end = time.monotonic() + (duration_s or float("inf"))
            recorder.serve(executor, lambda: stop.came or time.monotonic() >= end, _DRAIN_LIMIT_S)
        found = recorder.summary(interrupted=stop.came)
        if refused := recorder.refusals.report():
            say(refused)
    if not found["messages"]:
        raise PtnsbcError(
            f"no message on {', '.join(patterns)}: does a fleet run in this ROS domain? "
            f"the empty bag is in {writer.directory}"
        )
    return found


class TopicRecorder(BagRecorder):
    """Subscriptions of `node` that write into an open `writer` topics of some `patterns`, as in a shell: `*` and `?`.

    `say` gets a line for each topic that cannot be recorded.
    """

    def __init__(
        self, node: Node, writer: BagWriter, patterns: Sequence[str], say: Callable[[str], None]
    ) -> None:
        super().__init__(node, writer)
        self._patterns = patterns
        self._say = say
        self._known: set[str] = set()
        self._tf = topic_info(topics.TF, lockstep=False)
        node.create_timer(_LOOK_S, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.flush_regularly()
        self.look()

    def look(self) -> None:
        """Subscribe to what has appeared since the last look."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._known or not any(fnmatchcase(name, p) for p in self._patterns):
                continue
            offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
            if offered:  # without a publisher there are subscriptions only
                self._known.add(name)
                self._add(Topic(name, types[0], Role.STATE), offered)

    def _add(self, topic: Topic, offered: Sequence[QoSProfile]) -> None:
        try:
            declared = describe(topic.name, topic.type, offered)
            self._writer.add(declared)
            topics.message_class(topic)
        except (BagError, ImportError, AttributeError) as error:
            self._say(f"{topic.name} is left out: {error}")
            return
        derived: list[tuple[str, Derive]] = []
        own = OWN_ODOMETRY.fullmatch(topic.name)
        if own and topic.type == topics.odom(1).type and topics.TF.name not in self._known:
            self._writer.add(self._tf)
            transforms = Transforms([int(own[1])])

            def transform(name: str, data: bytes) -> bytes | None:
                """Until a process is known to publish /tf."""
                made = transforms.of(name, data)
                return None if topics.TF.name in self._known else made

            derived.append((topics.TF.name, transform))
        (offer,) = declared.qos
        profile = qos.keep_last(
            _QUEUE,
            reliable=offer["reliability"] == "reliable",
            latched=offer["durability"] == "transient_local",
        )
        self.subscribe(topic, topic.name, self.on_arrival(topic, derived), profile)
