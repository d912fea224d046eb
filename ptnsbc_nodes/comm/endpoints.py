"""The raw publishers and subscriptions of one node, and whether each has found its other end."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, TypeVar

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.door import Door, Refusals, opened
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import TF, Role, Topic, message_class

# The last message alone is not enough: a node that joins late must learn the first epoch, and of every lost UAV.
_LATCHED = qos.keep_last(64, reliable=True, latched=True)

_LOCKSTEP_HISTORY = 1000
_LOCKSTEP_STATUSES = 100  # of what is published 5 times a second: the sim is at most 80 of them ahead of the recorder
# With a queue of one the messages of an outsider would push out the true one before it is taken.
_STATE = qos.keep_last(32, reliable=False)
_SENT = "sent "
_UNNAMED = "_NODE_NAME_UNKNOWN_"  # of rmw_dds_common
_AT_ONCE = Duration()
_ACKED_LOOK_S = 0.005

T = TypeVar("T")


class _CountingPublisher:
    """A publisher that counts its messages."""

    def __init__(
        self, publisher: Publisher, readers: int, close: Callable[[bytes], bytes] | None
    ) -> None:
        self.publisher = publisher
        self.topic_name: str = publisher.topic_name
        self.readers = readers  # nodes of the fleet that must subscribe before the flight
        self.found = False  # they have been found
        self.sent = 0
        self._publish = publisher.publish
        self._close = close

    def send(self, data: bytes) -> None:
        self.sent += 1
        self._publish(data if self._close is None else self._close(data))


class PublishCounters(NamedTuple):
    """The number of messages that a process has published, by topic."""

    since_ns: int  # when `before` was counted, by the node's clock; -1: from the start
    before: dict[str, int]
    sent: dict[str, int]  # in all


def _node_name(publisher: TopicEndpointInfo) -> str:
    """The full name of the node of a publisher, as far as its participant has told it."""
    if publisher.node_name == _UNNAMED:
        return "an unknown node"
    return f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"


def fleet_namespace(namespace: str) -> str:
    """The namespace that a fleet's names are relative to, empty for the root.

    Nodes of one UAV live in `<fleet>/uavN`, all others in `<fleet>`.
    """
    above, _, last = namespace.rpartition("/")
    return above if re.fullmatch(r"uav\d+", last) else namespace.rstrip("/")


def full_name(node: Node, topic: Topic) -> str:
    """The name of a topic for this node, before remapping: only /tf is common to all fleets of a domain."""
    return topic.name if topic is TF else fleet_namespace(node.get_namespace()) + topic.name


def sent_in(lines: Iterable[str]) -> PublishCounters | None:
    """The counts that a process has written into its log; None without any."""
    counts = [line.removeprefix(_SENT) for line in lines if line.startswith(_SENT)]
    return PublishCounters(**json.loads(counts[-1])) if counts else None


def wait_for_readers(publishers: Iterable[Publisher], timeout_s: float) -> bool:
    """Wait until all reliable readers have all messages; returns whether they have within `timeout_s`.

    rclpy keeps Python's lock while it waits in one piece, for up to the 3 s that Fast DDS leaves between two
    questions: no other thread could answer an order meanwhile. So it is asked, and does not wait.
    """
    end, unread = time.monotonic() + timeout_s, list(publishers)
    while unread := [one for one in unread if not one.wait_for_all_acked(_AT_ONCE)]:
        if time.monotonic() >= end:
            return False
        time.sleep(_ACKED_LOOK_S)
    return True


class Endpoints:
    """Raw publishers and subscriptions of one node: bytes in, bytes out, no message objects."""

    def __init__(self, node: Node, lockstep: bool, seal: Seal | None = None) -> None:
        """`seal`: closes what is published and opens what is received; None in a fleet without one."""
        self._node = node
        self._seal = seal
        self._shared = set(topics.SEVERAL_PUBLISHERS)
        self.fleet = fleet_namespace(node.get_namespace())
        self._lockstep = lockstep
        self._published: list[_CountingPublisher] = []
        self._subscriptions: list[Subscription] = []
        self._awaited: list[Subscription] = []
        self.refusals = Refusals()
        self._before: tuple[int, dict[str, int]] | None = None
        self._last_word: Callable[[], None] | None = None

    def publisher(self, topic: Topic, readers: int) -> Callable[[bytes], None]:
        """A publisher of serialised messages, which `readers` nodes of the fleet must hear before the flight."""
        publisher = self._node.create_publisher(
            message_class(topic),
            full_name(self._node, topic),
            self._offered(topic),
            event_callbacks=qos.NO_WRITER_EVENTS,
        )
        close = None if self._seal is None else self._seal.closer(topic)
        self._published.append(_CountingPublisher(publisher, readers, close))
        return self._published[-1].send

    def readers(self, topic: Topic) -> Callable[[], int]:
        """A function that counts the subscriptions to a topic that this node publishes."""
        name = full_name(self._node, topic)
        [own] = (
            one for one in self._published if one.topic_name == self._node.resolve_topic_name(name)
        )
        return own.publisher.get_subscription_count

    def listen(
        self,
        topic: Topic,
        decode: Callable[[bytes], T],
        deliver: Callable[[T], None],
        required: bool = True,
        profile: QoSProfile | None = None,
    ) -> str:
        """Subscribe to a topic, through a `Door`.

        Args:
            topic: A `required` topic needs a publisher before the flight.
            decode: Serialised message to what `deliver` takes; a PtnsbcError refuses the message.
            deliver: Takes each message that is not refused.
            required: See `topic`.
            profile: Instead of the topic's own.

        Returns:
            The topic's name after remapping, as `unheard` has it.
        """
        name = full_name(self._node, topic)
        if self._seal is not None:
            decode = opened(self._seal.opener(topic, lockstep=self._lockstep), decode)
        subscription = self._node.create_subscription(
            message_class(topic),
            name,
            Door(name, decode, deliver, self.refusals),
            profile or self._requested(topic),
            raw=True,
            event_callbacks=qos.NO_READER_EVENTS,
        )
        self._subscriptions.append(subscription)
        if required:
            self._awaited.append(subscription)
        return str(subscription.topic_name)

    def ignore(self, name: str) -> None:
        """Destroy the subscriptions to the topic that `listen` has returned the name of."""
        for subscription in [one for one in self._subscriptions if one.topic_name == name]:
            self._subscriptions.remove(subscription)
            if subscription in self._awaited:
                self._awaited.remove(subscription)
            self._node.destroy_subscription(subscription)

    def unheard(self) -> list[str]:
        """Required topics without a publisher."""
        return [sub.topic_name for sub in self._awaited if sub.get_publisher_count() == 0]

    def unread(self) -> list[str]:
        """Published topics to which fewer nodes of the fleet subscribe than are to read them.

        A viewer must not stand in for a node that has not been found yet: what that one missed would not come again.
        """
        return [one.topic_name for one in self._published if not self._is_read(one)]

    def unmatched(self, topic: Topic, readers: Mapping[int, int]) -> list[str]:
        """UAVs of which fewer nodes than `readers` are known to subscribe to a topic."""
        name = full_name(self._node, topic)
        infos = self._node.get_subscriptions_info_by_topic(name)
        found = Counter(info.node_namespace for info in infos)
        short = [uav for uav, nodes in readers.items() if found[f"{self.fleet}/uav{uav}"] < nodes]
        return [f"{name} at uav{uav}" for uav in short]

    def shares(self, topic: Topic) -> None:
        """Several nodes publish this topic in this flight."""
        self._shared.add(topic.name)

    def rivals(self) -> list[str]:
        """Topics of one publisher that have several, with the nodes that publish them; nothing tells which is ours."""
        rivals = []
        for subscription in self._subscriptions:
            name = subscription.topic_name
            shared = name.removeprefix(self.fleet) in self._shared
            if shared or subscription.get_publisher_count() < 2:
                continue
            nodes = sorted(map(_node_name, self._node.get_publishers_info_by_topic(name)))
            if len(nodes) > 1:  # the graph may have lost one of them already
                rivals.append(f"{name}: {' and '.join(nodes)} publish it")
        return rivals

    def warning(self) -> str:
        """Messages that were refused since the last call, or else a rival; empty without any."""
        refused = self.refusals.report()
        return refused or "".join(f"second publisher of {one}" for one in self.rivals()[:1])

    def contested(self) -> list[str]:
        """Before a flight: what a fleet waits for that has no seal, and so believes whoever publishes."""
        return [] if self._seal else [f"a single publisher of {one}" for one in self.rivals()]

    def begin(self, now_ns: int) -> None:
        """The first leg has been announced: from here on every message counts."""
        if self._before is None:
            self._before = (now_ns, self._counts())

    def account(self) -> str:
        """The number of messages that were sent, as the line of the log that `sent_in` reads."""
        since_ns, before = self._before or (-1, {})
        return _SENT + json.dumps(PublishCounters(since_ns, before, self._counts())._asdict())

    def end_with(self, last_word: Callable[[], None]) -> None:
        """Let `say_last_word` call this: it publishes one reliable message behind those sent with best effort.

        A state that is sent with best effort is not acknowledged, and is lost with the shared memory of its process
        when its reader is slow. A reader receives the messages of one process in order: a reader that has
        acknowledged the last word has the states before it.
        """
        self._last_word = last_word

    def say_last_word(self) -> None:
        """Publish the message that the process ends with, before `flush`."""
        if self._last_word is not None:
            self._last_word()

    def flush(self, timeout_s: float) -> None:
        """Wait until reliable readers have everything: an earlier exit would cut their bags."""
        wait_for_readers([one.publisher for one in self._published], timeout_s)

    def close(self) -> None:
        """Destroy all publishers and subscriptions."""
        for one in self._published:
            self._node.destroy_publisher(one.publisher)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._published.clear()
        self._subscriptions.clear()
        self._awaited.clear()

    def _is_read(self, one: _CountingPublisher) -> bool:
        if one.publisher.get_subscription_count() < one.readers:
            return False
        if not one.found:
            infos = self._node.get_subscriptions_info_by_topic(one.topic_name)
            one.found = sum(map(self._is_of_fleet, infos)) >= one.readers
        return one.found

    def _is_of_fleet(self, reader: TopicEndpointInfo) -> bool:
        """True for the nodes of UAVs and their bridges, the sim and the recorder."""
        if fleet_namespace(reader.node_namespace) != self.fleet:
            return False
        of_uav = reader.node_namespace.rstrip("/") != self.fleet
        return of_uav or reader.node_name in (topics.SIM, topics.RECORDER)

    def _counts(self) -> dict[str, int]:
        return {one.topic_name: one.sent for one in self._published}

    def _offered(self, topic: Topic) -> QoSProfile:
        profile = self._profile(topic)
        if self._lockstep and topic.role is not Role.LATCHED:
            # The lock-step rule keeps all nodes within a few ticks, but not the recorder: messages that its
            # socket drops in a burst must still be there when it asks for them again.
            # A history fills up slowly with rare messages, and those of RViz are large.
            rare = topic.rate == topics.STATUS_RATE
            depth = _LOCKSTEP_STATUSES if rare else _LOCKSTEP_HISTORY
            return QoSProfile(depth=depth, reliability=profile.reliability)
        return profile

    def _requested(self, topic: Topic) -> QoSProfile:
        state = topic.role is Role.STATE and not self._lockstep
        return _STATE if state else self._profile(topic)

    def _profile(self, topic: Topic) -> QoSProfile:
        if topic.role is Role.LATCHED:
            return _LATCHED
        return qos.profile(topic, lockstep=self._lockstep)
