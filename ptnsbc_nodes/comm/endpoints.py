"""The topics of one node, all raw, and whether each has found its other end."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from ptnsbc_nodes.comm import qos
from ptnsbc_nodes.comm.topics import SHARED, STATUS_RATE, Role, Topic, message_class

RECORDER = "recorder"
"""Name of the recorder among the processes of a flight."""

LOST = Topic("/formation/lost", "std_msgs/msg/Header", Role.LATCHED, "once a loss")
"""Names of processes (uavN, recorder) that have ended, from the launcher: nobody waits for them."""

OVER = Topic("/formation/over", "std_msgs/msg/Header", Role.LATCHED, "once a flight")
"""The flight is over: from the launcher that leads to those on other computers."""

READY = Topic("/formation/ready", "diagnostic_msgs/msg/DiagnosticArray", Role.EVENT, STATUS_RATE)
"""/diagnostics of lock-step nodes before simulated time begins: how long that takes is chance, and
/diagnostics is in the bag."""

RECORDED = Topic("/formation/recorded", "std_msgs/msg/Header", Role.EVENT)
"""Stamp up to which the recorder has taken in a lock-step flight; the sim never runs far ahead of it."""

# The last message alone is not enough here: a late joiner must learn the first epoch too, and of
# every lost UAV.
_LATCHED = QoSProfile(
    depth=64,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

_LOCKSTEP_HISTORY = 1000
_SENT = "sent "


class _Outlet:
    """A publisher that counts."""

    def __init__(self, publisher: Publisher, readers: int) -> None:
        self.publisher = publisher
        self.readers = readers  # subscriptions that must match before the flight
        self.sent = 0
        self._publish = publisher.publish

    def send(self, data: bytes) -> None:
        self.sent += 1
        self._publish(data)


class PublishCounters(NamedTuple):
    """How many messages a process has published, by topic."""

    since_ns: int  # when `before` was counted, by the node's clock; -1: from the start
    before: dict[str, int]
    sent: dict[str, int]  # in all


def fleet_namespace(namespace: str) -> str:
    """The namespace that a fleet's names are relative to, empty for the root.

    Nodes of one UAV live in `<fleet>/uavN`, all others in `<fleet>`.
    """
    above, _, last = namespace.rpartition("/")
    return above if re.fullmatch(r"uav\d+", last) else namespace.rstrip("/")


def full_name(node: Node, topic: Topic) -> str:
    """The name of a topic for this node, before remapping."""
    return (
        topic.name if topic.name in SHARED else fleet_namespace(node.get_namespace()) + topic.name
    )


def sent_in(lines: Iterable[str]) -> PublishCounters | None:
    """What a process says in its log that it has sent; None when it does not."""
    told = [line.removeprefix(_SENT) for line in lines if line.startswith(_SENT)]
    return PublishCounters(**json.loads(told[-1])) if told else None


class Endpoints:
    """Raw publishers and subscriptions: bytes in, bytes out, no message objects."""

    def __init__(self, node: Node, lockstep: bool) -> None:
        self._node = node
        self.fleet = fleet_namespace(node.get_namespace())
        self._lockstep = lockstep
        self._outlets: list[_Outlet] = []
        self._subscriptions: list[Subscription] = []
        self._awaited: list[Subscription] = []
        self._before: tuple[int, dict[str, int]] | None = None

    def publisher(self, topic: Topic, readers: int) -> Callable[[bytes], None]:
        """A publisher of serialised messages; `readers` subscriptions must match it."""
        publisher = self._node.create_publisher(
            message_class(topic), full_name(self._node, topic), self._offered(topic)
        )
        outlet = _Outlet(publisher, readers)
        self._outlets.append(outlet)
        return outlet.send

    def listen(self, topic: Topic, callback: Callable[[bytes], None], required: bool = True) -> str:
        """Hear serialised messages; a `required` topic needs a publisher before the flight.

        Returns the topic's name after remapping, as `unheard` tells it.
        """
        subscription = self._node.create_subscription(
            message_class(topic),
            full_name(self._node, topic),
            callback,
            self._profile(topic),
            raw=True,
        )
        self._subscriptions.append(subscription)
        if required:
            self._awaited.append(subscription)
        return str(subscription.topic_name)

    def unheard(self) -> list[str]:
        """Required topics that nobody publishes yet."""
        return [sub.topic_name for sub in self._awaited if sub.get_publisher_count() == 0]

    def unread(self) -> list[str]:
        """Published topics that do not have all their readers yet."""
        return [
            outlet.publisher.topic_name
            for outlet in self._outlets
            if outlet.publisher.get_subscription_count() < outlet.readers
        ]

    def deaf(self, topic: Topic, readers: Mapping[int, int]) -> list[str]:
        """UAVs of which fewer nodes than there should be are known to hear a topic.

        `unread` counts readers, whoever they are: a viewer may stand in for a UAV that has not been found yet.
        """
        name = full_name(self._node, topic)
        infos = self._node.get_subscriptions_info_by_topic(name)
        heard = Counter(info.node_namespace for info in infos)
        short = [uav for uav, nodes in readers.items() if heard[f"{self.fleet}/uav{uav}"] < nodes]
        return [f"{name} at uav{uav}" for uav in short]

    def begin(self, now_ns: int) -> None:
        """The first leg has been announced: from here on every message counts."""
        if self._before is None:
            self._before = (now_ns, self._counts())

    def account(self) -> str:
        """What was sent, in a line for the log that `sent_in` reads: to compare a bag with."""
        since_ns, before = self._before or (-1, {})
        return _SENT + json.dumps(PublishCounters(since_ns, before, self._counts())._asdict())

    def _counts(self) -> dict[str, int]:
        return {outlet.publisher.topic_name: outlet.sent for outlet in self._outlets}

    def flush(self, timeout_s: float) -> None:
        """Wait until reliable readers have everything: leaving earlier would cut their bags."""
        end = time.monotonic() + timeout_s
        for outlet in self._outlets:
            outlet.publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))

    def close(self) -> None:
        """Take all topics away."""
        for outlet in self._outlets:
            self._node.destroy_publisher(outlet.publisher)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._outlets.clear()
        self._subscriptions.clear()
        self._awaited.clear()

    def _offered(self, topic: Topic) -> QoSProfile:
        profile = self._profile(topic)
        if self._lockstep and topic.role is not Role.LATCHED:
            # Taking turns keeps all nodes within a few ticks, but not the recorder: what its socket drops
            # in a burst must still be there when it asks again.
            return QoSProfile(depth=_LOCKSTEP_HISTORY, reliability=profile.reliability)
        return profile

    def _profile(self, topic: Topic) -> QoSProfile:
        if topic.role is Role.LATCHED:
            return _LATCHED
        return qos.profile(topic, lockstep=self._lockstep)
