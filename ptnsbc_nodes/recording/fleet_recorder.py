"""Recording a flight into a bag: every topic of the given UAVs, as bytes.

/tf is made here, out of odometry (`Transforms`).

In real time a message is logged when it arrives. In lock-step it is logged at its own stamp and
sorted (`ReorderBuffer`), so that the same command gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator

from rclpy.node import Node

from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.reorder import PendingMessage, ReorderBuffer
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.announcements import decode_lost
from ptnsbc_nodes.comm.endpoints import full_name
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.comm.topics import RECORDED, RECORDED_EVERY, SIM, Role, Topic
from ptnsbc_nodes.recording.completeness import Completeness
from ptnsbc_nodes.recording.recorder import BagRecorder, Derive, describe, stamp_of

_OWN = re.compile(r"/uav(\d+)/odom")

# Published by every UAV: the order of arrival between UAVs is chance even within the topic.
_SHARED = frozenset({topics.DIAGNOSTICS.name, topics.TF.name})


def topic_info(topic: Topic, *, lockstep: bool) -> TopicInfo:
    """The description of `topic` in a bag: the profile that its publishers offer."""
    return describe(topic.name, topic.type, [qos.profile(topic, lockstep=lockstep)])


def _sources(recorded: Iterable[Topic]) -> Iterator[str]:
    """The regular senders in lock-step: every topic of a UAV, the sim's, and each process on /diagnostics."""
    names = [
        topic.name
        for topic in recorded
        if topic.role is not Role.LATCHED and topic.rate != topics.ON_DEMAND
    ]
    for name in names:
        if name == topics.DIAGNOSTICS.name:
            yield SIM
            yield from (f"uav{found[1]}" for found in map(_OWN.fullmatch, names) if found)
        else:
            yield name


def _told(uav: int) -> tuple[str, ...]:
    """The sources of the process of a UAV."""
    return f"uav{uav}", *(topic.name for topic in topics.of_uav(uav)[2:])


def _sender_of(diagnostics: bytes) -> str:
    """The process that a message on /diagnostics is of; empty when it cannot be read."""
    try:
        statuses = wire.decode_diagnostics(diagnostics).statuses
    except wire.WireError:
        return ""
    return statuses[0].name.partition(":")[0] if statuses else ""


class FleetRecorder(BagRecorder):
    """Subscriptions of `node` that write into an open `writer`.

    Args:
        node: Its clock gives the log time in real time.
        writer: An open bag with all `recorded` topics and /tf; it stays open at `finish`.
        recorded: What to record.
        transforms: Makes /tf.
        lockstep: Log at the message's own stamp, in an order that does not depend on arrival.
        draw: Makes the markers in real time, where no simulator does.
        seal: Of a fleet whose messages are sealed; a bag holds them without it.
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
        seal: Seal | None = None,
        silences: Iterable[tuple[int, int, int]] = (),
    ) -> None:
        """`silences`: UAV, first instant [ns] and the first after it, in which it is to send nothing."""
        super().__init__(node, writer, seal)
        self._acknowledged_ns = 0
        self._clock_ns = 0  # newest /clock of a lock-step flight
        recorded = tuple(recorded)
        quiet: dict[str, list[tuple[int, int]]] = {}
        for uav, first_ns, end_ns in silences:
            for source in _told(uav):
                quiet.setdefault(source, []).append((first_ns, end_ns))
        self._completeness = Completeness(_sources(recorded), quiet)
        self._acknowledgement = wire.HeaderTemplate("recorder")
        self._close: Callable[[bytes], bytes] = bytes if seal is None else seal.closer(RECORDED)
        self._transforms = transforms
        order = ReorderBuffer(_SHARED) if lockstep else None
        self._order = order
        self._written_ns = -1
        # Topics whose first message is still to come before the first instant is known to be whole.
        self._awaited = {topic.name for topic in recorded if topic.role is Role.LATCHED}
        self._begun = topics.TAKEN in recorded  # at any instant
        derived: list[tuple[str, Derive]] = [(topics.TF.name, transforms.of)]
        if draw is not None:
            derived.append((topics.MARKERS.name, draw))
        for topic in recorded:
            record = self._in_order(topic, order) if order else self.on_arrival(topic, derived)
            profile = qos.recorder_profile(topic, lockstep=lockstep)
            self.subscribe(topic, full_name(node, topic), record, profile)
        if order is not None:
            order.complete_ns = self._completeness.complete_ns
            latched = qos.recorder_profile(topics.LOST, lockstep=True)
            self.subscribe(topics.LOST, full_name(node, topics.LOST), self._on_lost, latched)
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
            source = topic.name
            if source == topics.CLOCK.name:
                self._clock_ns = max(self._clock_ns, last_ns)
            elif source == topics.DIAGNOSTICS.name:
                source = _sender_of(data)
            if self._completeness.add(source, last_ns):
                self._on_complete(order)
            self._write_sorted(order.push(last_ns, topic.name, data))
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._write_sorted(order.push(last_ns, topics.TF.name, transform))
            if not self._begun:
                self._begin(topic, order)
            self.after_each()

        return record

    def _begin(self, heard: Topic, order: ReorderBuffer) -> None:
        """Write the first instant as soon as it is whole: a recorder killed afterwards leaves a readable bag."""
        self._awaited.discard(heard.name)
        if self._written_ns < 0 and not self._awaited:
            self._write_sorted(order.first())
            self._writer.flush()
        self._begun = self._written_ns >= 0

    def _on_complete(self, order: ReorderBuffer) -> None:
        """Acknowledge to the sim that all topics have been received up to some stamp.

        Ticks are counted by stamps: where a status arrives last, it completes all ticks since the one before.
        """
        order.complete_ns = self._completeness.complete_ns
        stamp_ns = min(max(order.complete_ns, 0), self._clock_ns)
        if stamp_ns - self._acknowledged_ns >= RECORDED_EVERY * self._completeness.tick_ns:
            self._acknowledged_ns = stamp_ns
            self._acknowledge.publish(self._close(self._acknowledgement.encode(stamp_ns)))

    def _on_lost(self, data: bytes) -> None:
        """Wait for the messages of a UAV no longer; those about its vehicle still come, from the sim."""
        try:
            process = decode_lost(data)
        except wire.WireError as error:
            self.refusals.add(topics.LOST.name, str(error))
            return
        if process.uav is None or self._order is None:
            return
        moved = [self._completeness.lose(source) for source in _told(process.uav)]
        if any(moved):
            self._on_complete(self._order)

    def _write_sorted(self, messages: Iterable[PendingMessage]) -> None:
        """Write messages in their order; chunks end between two instants."""
        for message in messages:
            if message.stamp_ns > self._written_ns:
                self._written_ns = message.stamp_ns
                self._writer.flush_if_due(message.stamp_ns * 1e-9)
            self._writer.write(message.topic, message.stamp_ns, message.data)
