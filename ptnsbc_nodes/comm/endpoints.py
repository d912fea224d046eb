"""The raw publishers and subscriptions of one node, and whether each has found its other end."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.door import Door, Refusals
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import TF, Topic, message_class

_UNNAMED = "_NODE_NAME_UNKNOWN_"  # of rmw_dds_common
_AT_ONCE = Duration()
_ACKED_LOOK_S = 0.005

T = TypeVar("T")


def fleet_namespace(namespace: str) -> str:
    """The namespace that a fleet's names are relative to, empty for the root.

    Nodes of one UAV live in `<fleet>/uavN`, all others in `<fleet>`.
    """
    above, _, last = namespace.rpartition("/")
    return above if re.fullmatch(r"uav\d+", last) else namespace.rstrip("/")


def full_name(node: Node, topic: Topic) -> str:
    """The name of a topic for this node, before remapping: only /tf is common to all fleets of a domain."""
    return topic.name if topic is TF else fleet_namespace(node.get_namespace()) + topic.name


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


@dataclass
class _AwaitingPublisher:
    """A publisher that a number of nodes of the fleet must hear before the flight."""

    node: Node
    publisher: Publisher
    readers: int
    found: bool = False

    def is_read(self) -> bool:
        """True once enough nodes of the fleet subscribe, known by their names, and still as many of any.

        A viewer must not stand in for a node that has not been found yet: what that one missed would not come again.
        So those that count are the nodes of UAVs and their bridges, the sim and the recorder.
        """
        if self.publisher.get_subscription_count() < self.readers:
            return False
        if not self.found:
            fleet, count = fleet_namespace(self.node.get_namespace()), 0
            for reader in self.node.get_subscriptions_info_by_topic(self.publisher.topic_name):
                of_uav = reader.node_namespace.rstrip("/") != fleet
                counts = of_uav or reader.node_name in (topics.SIM, topics.RECORDER)
                count += counts and fleet_namespace(reader.node_namespace) == fleet
            self.found = count >= self.readers
        return self.found


class Endpoints:
    """Raw publishers and subscriptions of one node: bytes in, bytes out, no message objects."""

    def __init__(
        self,
        node: Node,
        lockstep: bool,
        seal: Seal | None = None,
        after: Callable[[], None] = lambda: None,
    ) -> None:
        """`seal`: closes what is published and opens what is received; `after`: called after each message."""
        self.fleet = fleet_namespace(node.get_namespace())
        self.shared = set(topics.SEVERAL_PUBLISHERS)  # names of what several nodes publish
        self.refusals = Refusals()
        self.last_word: Callable[[], None] = lambda: None
        """Publishes one reliable message, behind those sent with best effort, when the process ends.

        A state that is sent with best effort is not acknowledged, and is lost with the shared memory of its process
        when its reader is slow. A reader receives the messages of one process in order: once it has acknowledged the
        last word it has the states before it.
        """
        self._node, self._lockstep, self._seal, self._after = node, lockstep, seal, after
        self._published: list[_AwaitingPublisher] = []
        self._subscriptions: list[Subscription] = []
        self._awaited: list[Subscription] = []

    def publisher(self, topic: Topic, readers: int) -> Callable[[bytes], None]:
        """A publisher of serialised messages, which `readers` nodes of the fleet must hear before the flight."""
        publisher = self._node.create_publisher(
            message_class(topic),
            full_name(self._node, topic),
            qos.offered(topic, lockstep=self._lockstep),
            event_callbacks=qos.NO_WRITER_EVENTS,
        )
        self._published.append(_AwaitingPublisher(self._node, publisher, readers))
        if self._seal is None:
            publish: Callable[[bytes], None] = publisher.publish
            return publish
        close = self._seal.closer(topic)
        return lambda data: publisher.publish(close(data))

    def readers(self, topic: Topic) -> Callable[[], int]:
        """A function that counts the subscriptions to a topic that this node publishes."""
        name = self._node.resolve_topic_name(full_name(self._node, topic))
        (publisher,) = (
            one.publisher for one in self._published if one.publisher.topic_name == name
        )
        return publisher.get_subscription_count

    def listen(
        self,
        topic: Topic,
        decode: Callable[[bytes], T],
        deliver: Callable[[T], None],
        required: bool = True,
        profile: QoSProfile | None = None,
    ) -> str:
        """Subscribe to a topic, through a `Door`: a PtnsbcError of `decode` refuses a message.

        A `required` topic needs a publisher before the flight; `profile` is used instead of the topic's own. Returns
        the topic's name after remapping, as `unheard` has it.
        """
        name, read = full_name(self._node, topic), decode
        if self._seal is not None:
            open_sealed = self._seal.opener(topic, lockstep=self._lockstep)
            read = lambda data: decode(open_sealed(data))  # noqa: E731
        subscription = self._node.create_subscription(
            message_class(topic),
            name,
            Door(name, read, deliver, self.refusals, after=self._after),
            profile or qos.requested(topic, lockstep=self._lockstep),
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
        """Published topics to which fewer nodes of the fleet subscribe than are to read them."""
        return [one.publisher.topic_name for one in self._published if not one.is_read()]

    def unmatched(self, topic: Topic, readers: Mapping[int, int]) -> list[str]:
        """UAVs of which fewer nodes than `readers` are known to subscribe to a topic."""
        name = full_name(self._node, topic)
        infos = self._node.get_subscriptions_info_by_topic(name)
        nodes = Counter(info.node_namespace for info in infos)
        short = [uav for uav, least in readers.items() if nodes[f"{self.fleet}/uav{uav}"] < least]
        return [f"{name} at uav{uav}" for uav in short]

    def is_heard_by(self, topic: Topic, node_name: str) -> bool:
        """True if a node of this name subscribes to a topic."""
        infos = self._node.get_subscriptions_info_by_topic(full_name(self._node, topic))
        return any(info.node_name == node_name for info in infos)

    def rivals(self) -> list[str]:
        """Topics of one publisher that have several, with the nodes that publish them; nothing tells which is ours."""
        rivals = []
        for subscription in self._subscriptions:
            if subscription.get_publisher_count() < 2:
                continue
            name = subscription.topic_name
            if name.removeprefix(self.fleet) in self.shared:
                continue
            nodes = sorted(
                "an unknown node"  # as far as its participant has told it
                if one.node_name == _UNNAMED
                else f"{one.node_namespace.rstrip('/')}/{one.node_name}"
                for one in self._node.get_publishers_info_by_topic(name)
            )
            if len(nodes) > 1:  # the graph may have lost one of them already
                rivals.append(f"{name}: {' and '.join(nodes)} publish it")
        return rivals

    def contested(self) -> list[str]:
        """Before a flight: what a fleet waits for that has no seal, and so believes whoever publishes."""
        return [] if self._seal else [f"a single publisher of {one}" for one in self.rivals()]

    def warning(self) -> str:
        """Messages that were refused since the last call, or else a rival; empty without any."""
        refused = self.refusals.report()
        return refused or "".join(f"second publisher of {one}" for one in self.rivals()[:1])

    def flush(self, timeout_s: float) -> None:
        """Wait until reliable readers have everything: an earlier exit would cut their bags."""
        wait_for_readers([one.publisher for one in self._published], timeout_s)

    def close(self) -> None:
        """Destroy all publishers and subscriptions."""
        for one in self._published:
            self._node.destroy_publisher(one.publisher)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for ends in (self._published, self._subscriptions, self._awaited):
            ends.clear()
