"""Recording beside any fleet that runs: topics are found, not known in advance.

Each topic is subscribed to with what its publishers offer, at once or when it appears. Messages are
logged when they arrive. /tf is made of odometry where nobody publishes it (`transforms`).
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from ptnsbc_io.bag import BagError, BagWriter, TopicInfo
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.comm.topics import Role, Topic
from ptnsbc_nodes.recording.fleet_recorder import stamp_of, topic_info

OURS = (
    *("/uav*/" + name for name in ("odom", "near", "formation_state", "leader_estimate")),
    *("/uav*/" + name for name in ("setpoint/*", "tick", "snapshot")),
    *("/formation/epoch", "/formation/markers", "/diagnostics", "/clock", "/tf"),
)
"""Topics of a flight, as patterns."""

_LOOK_S = 0.5  # between two looks for new topics
_FLUSH_CHECK_S = 0.1
_QUEUE = 1000
_OWN_ODOMETRY = re.compile(r"/uav(\d+)/odom")


class TopicRecorder:
    """Subscriptions of `node` that write into an open `writer`.

    Args:
        node: Its clock gives the log time.
        writer: An open bag; topics are added to it.
        patterns: Which topics, as in a shell: `*` and `?`.
        say: Gets a line for each topic that cannot be recorded.
    """

    def __init__(
        self, node: Node, writer: BagWriter, patterns: Sequence[str], say: Callable[[str], None]
    ) -> None:
        self.received = 0
        self.lost = 0  # as far as DDS reports it
        self.after_each: Callable[[], None] = lambda: None  # called after each message
        self._node = node
        self._writer = writer
        self._patterns = patterns
        self._say = say
        self._known: set[str] = set()
        self._transforms: dict[str, Transforms] = {}
        self._frames = topic_info(topics.TF, lockstep=False)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK_S, self.look, clock=steady)
        node.create_timer(_FLUSH_CHECK_S, self._flush, clock=steady)
        self.look()

    @property
    def heard(self) -> int:
        """Topics that are recorded."""
        return len(self._writer.counts)

    def look(self) -> None:
        """Subscribe to what has appeared since the last look."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._known or not any(fnmatchcase(name, p) for p in self._patterns):
                continue
            offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
            if offered:  # else somebody listens, and nobody speaks yet
                self._known.add(name)
                self._subscribe(name, types[0], offered)

    def _subscribe(self, name: str, kind: str, offered: Sequence[QoSProfile]) -> None:
        topic = Topic(name, kind, Role.STATE)
        info = _described(name, kind, offered)
        try:
            self._writer.add(info)
            message_class = topics.message_class(topic)
        except (BagError, ImportError, AttributeError) as error:
            self._say(f"{name} is left out: {error}")
            return
        own = _OWN_ODOMETRY.fullmatch(name)
        if own and kind == topics.odom(1).type and topics.TF.name not in self._known:
            self._writer.add(self._frames)
            self._transforms[name] = Transforms([int(own[1])])
        self._node.create_subscription(
            message_class,
            name,
            self._hearer(topic),
            _requested(info),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._count_lost),
        )

    def _hearer(self, topic: Topic) -> Callable[[bytes], None]:
        clock, transforms = self._node.get_clock(), self._transforms.get(topic.name)

        def hear(data: bytes) -> None:
            self.received += 1
            now_ns, stamp_ns = clock.now().nanoseconds, stamp_of(topic, data)
            self._writer.write(topic.name, now_ns, data, stamp_ns)
            frame = transforms.of(topic.name, data) if transforms else None
            if frame is not None and topics.TF.name not in self._known:
                self._writer.write(topics.TF.name, now_ns, frame, stamp_ns)
            self.after_each()

        return hear

    def _count_lost(self, event: Any) -> None:
        self.lost += event.total_count_change

    def _flush(self) -> None:
        self._writer.flush_if_due(time.monotonic())


def _described(name: str, kind: str, offered: Sequence[QoSProfile]) -> TopicInfo:
    """What all publishers of a topic offer: the least of them decides."""
    reliable = all(qos.reliability == QoSReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return TopicInfo(
        name,
        kind,
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        max([1, *(qos.depth for qos in offered)]),  # discovery does not tell every depth
    )


def _requested(info: TopicInfo) -> QoSProfile:
    return QoSProfile(
        depth=_QUEUE,
        reliability=QoSReliabilityPolicy.RELIABLE
        if info.reliability == "reliable"
        else QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL
        if info.durability == "transient_local"
        else QoSDurabilityPolicy.VOLATILE,
    )
