"""Recording a flight into a bag: every topic of the given UAVs, as bytes.

/tf is made here, out of odometry (`Transforms`).

In real time a message is logged when it arrives. In lock-step it is logged at its own stamp and
sorted (`ReorderBuffer`), so that the same command gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rclpy.node import Node

from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.reorder import PendingMessage, ReorderBuffer
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.endpoints import full_name
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.comm.topics import RECORDED, Topic
from ptnsbc_nodes.recording.recorder import BagRecorder, Derive, describe, stamp_of

_ACK_TICKS = 25

# Published by every UAV: the order of arrival between UAVs is chance even within the topic.
_SHARED = frozenset({topics.DIAGNOSTICS.name, topics.TF.name})


def topic_info(topic: Topic, *, lockstep: bool) -> TopicInfo:
    """How `topic` is described in a bag: the profile that its publishers offer."""
    return describe(topic.name, topic.type, [qos.profile(topic, lockstep=lockstep)])


class FleetRecorder(BagRecorder):
    """Subscriptions of `node` that write into an open `writer`.

    Args:
        node: Its clock gives the log time in real time.
        writer: An open bag with all `recorded` topics and /tf; it stays open at `finish`.
        recorded: What to record.
        transforms: Makes /tf.
        lockstep: Log at the message's own stamp, in an order that does not depend on arrival.
        draw: Makes the markers in real time, where no simulator does.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        recorded: Iterable[Topic],
        transforms: Transforms,
        *,
        lockstep: bool,
        draw: Derive | None = None,
    ) -> None:
        super().__init__(node, writer)
        self._ticks = 0
        self._acknowledgement = wire.HeaderTemplate("recorder")
        self._transforms = transforms
        self._order = order = ReorderBuffer(_SHARED) if lockstep else None
        derived: list[tuple[str, Derive]] = [(topics.TF.name, transforms.of)]
        if draw is not None:
            derived.append((topics.MARKERS.name, draw))
        for topic in recorded:
            record = self._in_order(topic, order) if order else self.on_arrival(topic, derived)
            profile = qos.recorder_profile(topic, lockstep=lockstep)
            self.subscribe(topic, full_name(node, topic), record, profile)
        if lockstep:
            self._acknowledge = node.create_publisher(
                topics.message_class(RECORDED), full_name(node, RECORDED), qos.EVENT
            )
        else:  # in lock-step the bytes would depend on wall time: flushed by stamp
            self.flush_regularly()

    @property
    def late(self) -> int:
        """Lock-step messages too late to be sorted in; above zero the bytes may differ."""
        return self._order.late if self._order else 0

    def finish(self) -> None:
        """Write what is still held back; call before the writer is closed."""
        if self._order:
            self._write_sorted(self._order.flush())

    def _in_order(self, topic: Topic, order: ReorderBuffer) -> Callable[[bytes], None]:
        last_ns = 0

        def record(data: bytes) -> None:
            nonlocal last_ns
            self.received += 1
            stamp_ns = stamp_of(topic, data)
            # An empty list has no stamp; that of its predecessor is the same on every run.
            last_ns = last_ns if stamp_ns is None else stamp_ns
            if topic.name == topics.CLOCK.name:
                self._on_tick(last_ns)
            self._write_sorted(order.push(last_ns, topic.name, data))
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._write_sorted(order.push(last_ns, topics.TF.name, transform))
            self.after_each()

        return record

    def _on_tick(self, stamp_ns: int) -> None:
        """Acknowledge to the sim: events are served in order, so all before this /clock has been received."""
        self._ticks += 1
        if self._ticks % _ACK_TICKS == 0:
            self._acknowledge.publish(self._acknowledgement.encode(stamp_ns))

    def _write_sorted(self, messages: Iterable[PendingMessage]) -> None:
        for message in messages:
            self._writer.write(message.topic, message.stamp_ns, message.data)
            self._writer.flush_if_due(message.stamp_ns * 1e-9)
