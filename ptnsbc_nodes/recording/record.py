"""A recording beside a running fleet, from its first look around to SIGINT, SIGTERM or its time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime import environment

environment.prepare()

import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402

from ptnsbc_io.bag import BagWriter, SplitLimits  # noqa: E402
from ptnsbc_nodes.recording.session import account, listen, listening_node  # noqa: E402
from ptnsbc_nodes.recording.topic_recorder import OURS, TopicRecorder  # noqa: E402
from ptnsbc_nodes.runtime.provenance import provenance  # noqa: E402
from ptnsbc_nodes.runtime.signals import StopRequest  # noqa: E402

_DRAIN_LIMIT_S = 2.0  # a fleet that flies on has no last message


class RecordError(PtnsbcError):
    """A recording that came to nothing."""


@dataclass(frozen=True)
class RecordOptions:
    """What to record, and how."""

    bag: Path
    topics: Sequence[str] = OURS  # patterns
    limits: SplitLimits = field(default_factory=SplitLimits)
    overwrite: bool = False
    duration_s: float | None = None  # None: until a signal
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    meta: Mapping[str, str] = field(default_factory=dict)


def record(wishes: RecordOptions, say: Callable[[str], None]) -> Mapping[str, Any]:
    """Record until the time is over or a signal; returns what was recorded.

    Raises:
        BagError: the bag cannot be written.
        RecordError: not one message came.
    """
    context = Context()
    with StopRequest() as stop:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            return _record(context, wishes, stop, say)
        finally:
            rclpy.shutdown(context=context)


def _record(
    context: Context, wishes: RecordOptions, stop: StopRequest, say: Callable[[str], None]
) -> Mapping[str, Any]:
    with listening_node(context, "record") as (node, executor):
        with BagWriter(
            wishes.bag,
            [],
            attachments=wishes.attachments,
            metadata={"mode": "beside", **provenance(), **wishes.meta},
            overwrite=wishes.overwrite,
            limits=wishes.limits,
        ) as writer:
            listener = TopicRecorder(node, writer, wishes.topics, say)
            say("ready")
            end = time.monotonic() + (wishes.duration_s or float("inf"))
            listen(executor, listener, lambda: stop.came or time.monotonic() >= end, _DRAIN_LIMIT_S)
        found = account(writer, listener, interrupted=stop.came)
    if not found["messages"]:
        raise RecordError(
            f"no message on {', '.join(wishes.topics)}: does a fleet run in this ROS domain? "
            f"the empty bag is in {writer.directory}"
        )
    return found
