"""Recording a flight into a bag: every topic of the given UAVs, as bytes. /tf is made here, out of odometry.

In real time a message is logged when it arrives. In lock-step it is logged at its own stamp and sorted, so that the
same command gives the same bytes. Every regular topic has a message each so many ticks, and DDS keeps the order of one
publisher. So a topic whose newest stamp is k and whose period is p lacks no message before k + p. Messages that are
lost on the way and sent again hold this back; the sim pauses before a queue can overflow, and the recorder does not
sort beyond it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from rclpy.node import Node

from ptnsbc_core.nanoseconds import seconds
from ptnsbc_io import wire
from ptnsbc_io.bag import BagWriter
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.agent_messages import Transforms
from ptnsbc_nodes.comm.announcements import decode_lost
from ptnsbc_nodes.comm.endpoints import full_name
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import RECORDED, RECORDED_EVERY, SIM, Role, Topic
from ptnsbc_nodes.recording.recorder import OWN_ODOMETRY, BagRecorder, Derive, stamp_of

# Published by every UAV: the order of arrival between UAVs is chance even within the topic.
_SHARED = frozenset({topics.DIAGNOSTICS.name, topics.TF.name})

_HOLD_TICKS = 20  # for the messages of topics without regular ones
_NEVER = 2**63 - 1


class PendingMessage(NamedTuple):
    """A message in the buffer."""

    stamp_ns: int
    topic: str
    arrival: int  # in its topic; 0 in a shared topic, where the bytes decide instead
    data: bytes


class ReorderBuffer:
    """Sorts messages by (stamp, topic, arrival in that topic).

    It counts stamps that occur. So the length of a tick need not be known, and a stamp far ahead (an epoch announced in
    advance) releases no other message. Within `shared` topics, which have several publishers, the order of arrival is
    random too.
    """

    def __init__(self, shared: frozenset[str] = frozenset()) -> None:
        self._shared = shared
        self._held: dict[int, list[PendingMessage]] = {}
        self._stamps: list[int] = []  # heap of the keys of _held
        self._arrivals: dict[str, int] = {}
        self._released_ns = -1
        self.late = 0  # messages that came after their stamp was released: in chance order

    def push(self, stamp_ns: int, topic: str, data: bytes) -> None:
        """Add a message."""
        arrival = self._arrivals.get(topic, 0)
        if topic not in self._shared:
            self._arrivals[topic] = arrival + 1
        self.late += stamp_ns <= self._released_ns
        if stamp_ns not in self._held:
            self._held[stamp_ns] = []
            heapq.heappush(self._stamps, stamp_ns)
        self._held[stamp_ns].append(PendingMessage(stamp_ns, topic, arrival, data))

    def release(self, complete_ns: int = _NEVER, keep: int = 0) -> list[PendingMessage]:
        """The messages of the stamps up to `complete_ns` that have `keep` later ones, in order: held no longer."""
        released: list[PendingMessage] = []
        while len(self._stamps) > keep and self._stamps[0] <= complete_ns:
            stamp_ns = heapq.heappop(self._stamps)
            self._released_ns = max(stamp_ns, self._released_ns)
            released += sorted(self._held.pop(stamp_ns))
        return released


class Completeness:
    """The stamp up to which all of some sources have been received.

    Args:
        sources: names; a source is what one publisher sends on one topic.
        silences: first instant [ns], and the first after it, of what a source sends nothing in.
    """

    def __init__(
        self,
        sources: Iterable[str],
        silences: Mapping[str, Sequence[tuple[int, int]]] | None = None,
    ) -> None:
        self._silences = silences or {}
        self._newest = dict.fromkeys(sources, -1)
        self._gap: dict[str, int] = {}  # shortest time between two messages of a source
        self._bounds = dict(self._newest)  # up to which each source is complete
        self.complete_ns = -1
        self.tick_ns = _NEVER
        """Shortest time between two messages of any source: the control period, once two messages have come."""

    def add(self, source: str, stamp_ns: int) -> bool:
        """A message of a source, whatever its name; returns whether `complete_ns` has moved."""
        newest, silences = self._newest.get(source), self._silences.get(source, ())
        if newest is None or stamp_ns <= newest:
            return False
        if newest >= 0 and not any(newest < first_ns < stamp_ns for first_ns, _ in silences):
            self._gap[source] = min(stamp_ns - newest, self._gap.get(source, _NEVER))
            self.tick_ns = min(self.tick_ns, self._gap[source])
        self._newest[source] = stamp_ns
        bound = stamp_ns + self._gap.get(source, 1) - 1
        for first_ns, end_ns in silences:
            if first_ns <= bound + 1 < end_ns:
                bound = end_ns - 1
        self._bounds[source] = bound
        return self._move()

    def lose(self, source: str) -> bool:
        """Wait for a source no longer; returns whether `complete_ns` has moved."""
        if source not in self._newest:
            return False
        del self._newest[source], self._bounds[source]
        return self._move()

    def _move(self) -> bool:
        before = self.complete_ns
        self.complete_ns = max(before, min(self._bounds.values(), default=_NEVER))
        return self.complete_ns > before


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
            yield from (f"uav{found[1]}" for found in map(OWN_ODOMETRY.fullmatch, names) if found)
        else:
            yield name


def _sources_of(uav: int) -> tuple[str, ...]:
    """The sources of the process of a UAV."""
    return f"uav{uav}", *(topic.name for topic in topics.of_uav(uav)[2:])


class RealTimeRecorder(BagRecorder):
    """Subscriptions of a node that log each message when it arrives.

    The writer is an open bag with all `recorded` topics and /tf; it stays open at `finish`. `draw` makes the markers,
    where no simulator does. A bag holds the messages of a sealed fleet without their `seal`.
    """

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        recorded: Iterable[Topic],
        transforms: Transforms,
        draw: Derive | None = None,
        seal: Seal | None = None,
    ) -> None:
        super().__init__(node, writer, seal)
        derived: list[tuple[str, Derive]] = [(topics.TF.name, transforms.of)]
        if draw is not None:
            derived.append((topics.MARKERS.name, draw))
        for topic in recorded:
            profile = qos.recorder_profile(topic, lockstep=False)
            used = derived if topic == topics.EPOCH or OWN_ODOMETRY.fullmatch(topic.name) else ()
            self.subscribe(topic, full_name(node, topic), self.on_arrival(topic, used), profile)
        self.flush_regularly()


class LockstepRecorder(BagRecorder):
    """Subscriptions of a node that log each message at its own stamp, in an order that does not depend on arrival.

    Bytes that depended on wall time would differ from run to run: what is written is flushed by stamp.
    """

    rest_s = 0.0  # the sim waits for it

    def __init__(
        self,
        node: Node,
        writer: BagWriter,
        recorded: Iterable[Topic],
        transforms: Transforms,
        seal: Seal | None = None,
        silences: Iterable[tuple[int, int, int]] = (),
    ) -> None:
        """As `RealTimeRecorder`; `silences`: UAV, first instant [ns] and the first after it, in which it is silent."""
        super().__init__(node, writer, seal)
        recorded = tuple(recorded)
        quiet: dict[str, list[tuple[int, int]]] = {}
        for uav, first_ns, end_ns in silences:
            for source in _sources_of(uav):
                quiet.setdefault(source, []).append((first_ns, end_ns))
        self._completeness = Completeness(_sources(recorded), quiet)
        self._transforms = transforms
        self._order = ReorderBuffer(_SHARED)
        self._written_ns = -1
        # Topics that have a message at the first instant, and no regular ones: nothing is written before they came.
        self._awaited = {topic.name for topic in recorded if topic.role is Role.LATCHED}
        self._begun = topics.TAKEN in recorded  # at any instant
        for topic in recorded:
            profile = qos.recorder_profile(topic, lockstep=True)
            self.subscribe(topic, full_name(node, topic), self._in_order(topic), profile)
        latched = qos.recorder_profile(topics.LOST, lockstep=True)
        self.subscribe(topics.LOST, full_name(node, topics.LOST), self._on_lost, latched)
        self._acknowledged_ns = 0
        self._clock_ns = 0  # newest /clock
        self._acknowledgement = wire.HeaderTemplate("recorder")
        self._close: Callable[[bytes], bytes] = bytes if seal is None else seal.closer(RECORDED)
        self._acknowledge = node.create_publisher(
            topics.message_class(RECORDED), full_name(node, RECORDED), qos.EVENT
        )

    def finish(self) -> None:
        """Write what is still held back; call before the writer is closed."""
        self._write_sorted(self._order.release())

    @property
    def late(self) -> int:
        """As of any recorder."""
        return self._order.late

    def _in_order(self, topic: Topic) -> Callable[[bytes, int], None]:
        last_ns = 0

        def record(data: bytes, _arrived_ns: int) -> None:
            nonlocal last_ns
            stamp_ns = stamp_of(topic, data)
            # An empty list has no stamp; that of its predecessor is the same on every run.
            last_ns = last_ns if stamp_ns is None else stamp_ns
            source = topic.name
            if source == topics.CLOCK.name:
                self._clock_ns = max(self._clock_ns, last_ns)
            elif source == topics.DIAGNOSTICS.name:
                statuses = wire.decode_diagnostics(data).statuses
                source = statuses[0].name.partition(":")[0] if statuses else ""
            # All of an instant is held before it may be complete: the odometry that completes it has a transform.
            self._order.push(last_ns, topic.name, data)
            transform = self._transforms.of(topic.name, data)
            if transform is not None:
                self._order.push(last_ns, topics.TF.name, transform)
            if self._completeness.add(source, last_ns):
                self._on_complete()
            self._awaited.discard(source)
            if not self._awaited:
                self._write_complete()

        return record

    def _write_complete(self) -> None:
        """Write what is whole; the first instant at once: a recorder killed afterwards leaves a readable bag."""
        complete_ns = self._completeness.complete_ns
        if not self._begun and complete_ns >= 0:
            self._begun = True
            self._write_sorted(self._order.release(0))
            self._writer.flush()
        self._write_sorted(self._order.release(complete_ns, _HOLD_TICKS))

    def _on_complete(self) -> None:
        """Acknowledge to the sim that all topics have been received up to some stamp.

        Ticks are counted by stamps: where a status arrives last, it completes all ticks since the one before.
        """
        stamp_ns = min(max(self._completeness.complete_ns, 0), self._clock_ns)
        if stamp_ns - self._acknowledged_ns >= RECORDED_EVERY * self._completeness.tick_ns:
            self._acknowledged_ns = stamp_ns
            self._acknowledge.publish(self._close(self._acknowledgement.encode(stamp_ns)))

    def _on_lost(self, data: bytes, _arrived_ns: int) -> None:
        """Wait for the messages of a UAV no longer; those about its vehicle still come, from the sim."""
        try:
            process = decode_lost(data)
        except wire.WireError as error:
            self.refusals.add(topics.LOST.name, str(error))
            return
        if process.uav is None:
            return
        moved = [self._completeness.lose(source) for source in _sources_of(process.uav)]
        if any(moved):
            self._on_complete()

    def _write_sorted(self, messages: Iterable[PendingMessage]) -> None:
        """Write messages in their order; chunks end between two instants."""
        for message in messages:
            if message.stamp_ns > self._written_ns:
                self._written_ns = message.stamp_ns
                self._writer.flush_if_due(seconds(message.stamp_ns))
            self._writer.write(message.topic, message.stamp_ns, message.data)
