"""Recording beside any fleet that runs, until SIGINT, SIGTERM or the end of its time.

Topics are found, not known in advance. Each topic is subscribed to with what its publishers offer, at once or
when it appears. Messages are logged when they arrive. /tf is made of odometry where no process publishes it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import BagError, BagWriter, SplitLimits
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.comm.topics import Role, Topic
from ptnsbc_nodes.recording.fleet_recorder import topic_info
from ptnsbc_nodes.recording.recorder import BagRecorder, Derive, describe, recorder_node
from ptnsbc_nodes.runtime.provenance import provenance
from ptnsbc_nodes.runtime.signals import StopRequest

OURS = (
    *("/uav*/" + name for name in ("odom", "near", "formation_state", "leader_estimate")),
    *("/uav*/" + name for name in ("setpoint/*", "tick", "snapshot")),
    *(
        "/formation/epoch",
        "/formation/slots",
        "/formation/markers",
        "/diagnostics",
        "/clock",
        "/tf",
    ),
)
"""Topics of a flight, as patterns."""

_LOOK_S = 0.5  # between two looks for new topics
_QUEUE = 1000
_DRAIN_LIMIT_S = 2.0  # a fleet that flies on has no last message
_OWN_ODOMETRY = re.compile(r"/uav(\d+)/odom")


class RecordError(PtnsbcError):
    """A recording without a single message."""


@dataclass(frozen=True)
class RecordOptions:
    """The topics to record, and how they are recorded."""

    bag: Path
    topics: Sequence[str] = OURS  # patterns
    limits: SplitLimits = field(default_factory=SplitLimits)
    overwrite: bool = False
    duration_s: float | None = None  # None: until a signal
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    meta: Mapping[str, str] = field(default_factory=dict)


def record(options: RecordOptions, say: Callable[[str], None]) -> Mapping[str, Any]:
    """Record until the time is over or a signal comes; returns what was recorded.

    Raises:
        BagError: the bag cannot be written.
        RecordError: not one message came.
    """
    context = Context()
    with StopRequest() as stop:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            return _record(context, options, stop, say)
        finally:
            rclpy.shutdown(context=context)


def _record(
    context: Context, options: RecordOptions, stop: StopRequest, say: Callable[[str], None]
) -> Mapping[str, Any]:
    with recorder_node(context, "record") as (node, executor):
        with BagWriter(
            options.bag,
            [],
            attachments=options.attachments,
            metadata={"mode": "beside", **provenance(), **options.meta},
            overwrite=options.overwrite,
            limits=options.limits,
        ) as writer:
            recorder = TopicRecorder(node, writer, options.topics, say)
            say("ready")
            end = time.monotonic() + (options.duration_s or float("inf"))
            recorder.serve(executor, lambda: stop.came or time.monotonic() >= end, _DRAIN_LIMIT_S)
        found = recorder.summary(interrupted=stop.came)
    if not found["messages"]:
        raise RecordError(
            f"no message on {', '.join(options.topics)}: does a fleet run in this ROS domain? "
            f"the empty bag is in {writer.directory}"
        )
    return found


class TopicRecorder(BagRecorder):
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
        info = describe(topic.name, topic.type, offered)
        reliable = info.reliability == "reliable"
        latched = info.durability == "transient_local"
        try:
            self._writer.add(info)
            topics.message_class(topic)
        except (BagError, ImportError, AttributeError) as error:
            self._say(f"{topic.name} is left out: {error}")
            return
        record = self.on_arrival(topic, self._derived(topic))
        self.subscribe(
            topic, topic.name, record, keep_last(_QUEUE, reliable=reliable, latched=latched)
        )

    def _derived(self, topic: Topic) -> list[tuple[str, Derive]]:
        """/tf out of the odometry of a UAV, as long as no process is known to publish /tf."""
        own = _OWN_ODOMETRY.fullmatch(topic.name)
        if not own or topic.type != topics.odom(1).type or topics.TF.name in self._known:
            return []
        self._writer.add(self._tf)
        transforms = Transforms([int(own[1])])

        def transform(name: str, data: bytes) -> bytes | None:
            made = transforms.of(name, data)
            return None if topics.TF.name in self._known else made

        return [(topics.TF.name, transform)]
