"""Recording a flight into a bag: every topic of the given UAVs, as bytes.

/tf is made here, out of odometry (`transforms`).

In real time a message is logged when it arrives. In lock-step it is logged at its own stamp and
sorted (`bag.reorder`), so that the same command gives the same bytes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy

from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.definitions import has_header
from ptnsbc_io.bag.reorder import PendingMessage, ReorderBuffer
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.endpoints import RECORDED, full_name
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.comm.topics import Topic

if TYPE_CHECKING:
    from ptnsbc_nodes.recording.marker_frames import MarkerFrames

_FLUSH_CHECK = 0.1  # [s]
_ACK_TICKS = 25

# Published by every UAV: order of arrival between them is chance even within the topic.
_SHARED = frozenset({topics.DIAGNOSTICS.name, topics.TF.name})
_LISTS = frozenset({topics.MARKERS.type, topics.TF.type})


def topic_info(topic: Topic, *, lockstep: bool) -> TopicInfo:
    """How `topic` is described in a bag: the profile that its publishers offer."""
    profile = qos.profile(topic, lockstep=lockstep)
    reliable = profile.reliability == QoSReliabilityPolicy.RELIABLE
    latched = profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL
    return TopicInfo(
        topic.name,
        topic.type,
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        profile.depth,
    )


class FleetRecorder:
    """Subscriptions of `node` that write into an open `writer`.

    Args:
        node: Its clock gives the log time in real time.
        writer: An open bag with all `recorded` topics and /tf; it stays open at `finish`.
        recorded: What to record.
        transforms: What makes /tf.
        lockstep: Log at the message's own stamp, in an order that does not depend on arrival.
        pictures: In real time, what makes the markers where no simulator does.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        recorded: Iterable[Topic],
        transforms: Transforms,
        *,
        lockstep: bool,
        pictures: MarkerFrames | None = None,
    ) -> None:
        self.received = 0
        self.lost = 0  # as far as DDS reports it: gaps in the network, not in our own queue
        self.after_each: Callable[[], None] = lambda: None  # called after each message
        self._ticks = 0
        self._acknowledgement = wire.HeaderTemplate("recorder")
        self._node = node
        self._writer = writer
        self._transforms = transforms
        self._pictures = pictures
        self._order = ReorderBuffer(_SHARED) if lockstep else None
        for topic in recorded:
            order = self._order
            record = self._sorted(topic, order) if order else self._as_it_arrives(topic)
            self._subscribe(topic, record, lockstep)
        if lockstep:
            self._acknowledge = node.create_publisher(
                topics.message_class(RECORDED), full_name(node, RECORDED), qos.EVENT
            )
        else:
            # By wall time: in lock-step, where the bytes would depend on it, by stamp.
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(_FLUSH_CHECK, self._flush, clock=steady)

    @property
    def late(self) -> int:
        """Lock-step messages too late to be sorted in; above zero the bytes may differ."""
        return self._order.late if self._order else 0

    def finish(self) -> None:
        """Write what is still held back; call before the writer is closed."""
        if self._order:
            self._write_sorted(self._order.flush())

    def _subscribe(self, topic: Topic, record: Callable[[bytes], None], lockstep: bool) -> None:
        self._node.create_subscription(
            topics.message_class(topic),
            full_name(self._node, topic),
            record,
            qos.recorder_profile(topic, lockstep=lockstep),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._count_lost),
        )

    def _as_it_arrives(self, topic: Topic) -> Callable[[bytes], None]:
        clock = self._node.get_clock()

        def record(data: bytes) -> None:
            self.received += 1
            now_ns, stamp_ns = clock.now().nanoseconds, stamp_of(topic, data)
            self._writer.write(topic.name, now_ns, data, stamp_ns)
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._writer.write(topics.TF.name, now_ns, transform, stamp_ns)
            picture = None if self._pictures is None else self._pictures.of(topic.name, data)
            if picture is not None:
                self._writer.write(topics.MARKERS.name, now_ns, picture, stamp_ns)
            self.after_each()

        return record

    def _sorted(self, topic: Topic, order: ReorderBuffer) -> Callable[[bytes], None]:
        last_ns = 0

        def record(data: bytes) -> None:
            nonlocal last_ns
            self.received += 1
            stamp_ns = stamp_of(topic, data)
            # An empty list has no stamp; that of its predecessor is the same on every run.
            last_ns = last_ns if stamp_ns is None else stamp_ns
            if topic.name == topics.CLOCK.name:
                self._tick(last_ns)
            self._write_sorted(order.push(last_ns, topic.name, data))
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._write_sorted(order.push(last_ns, topics.TF.name, transform))
            self.after_each()

        return record

    def _tick(self, stamp_ns: int) -> None:
        """Tell the sim how far we are: events are served in order, so with the clock came the rest."""
        self._ticks += 1
        if self._ticks % _ACK_TICKS == 0:
            self._acknowledge.publish(self._acknowledgement.encode(stamp_ns))

    def _write_sorted(self, messages: Iterable[PendingMessage]) -> None:
        for message in messages:
            self._writer.write(message.topic, message.stamp_ns, message.data)
            self._writer.flush_if_due(message.stamp_ns * 1e-9)

    def _count_lost(self, event: Any) -> None:
        self.lost += event.total_count_change

    def _flush(self) -> None:
        self._writer.flush_if_due(time.monotonic())


def stamp_of(topic: Topic, data: bytes) -> int | None:
    """The header stamp [ns] of a message, of its first element for a list; None without one."""
    listed = topic.type in _LISTS
    if not listed and not has_header(topic.type):
        return None
    try:
        stamp_ns = wire.peek_sequence_stamp(data) if listed else wire.peek_stamp(data)
    except wire.WireError:
        # Foreign and broken, but it was on the topic: it belongs into the bag.
        return None
    return stamp_ns if stamp_ns is not None and stamp_ns >= 0 else None
