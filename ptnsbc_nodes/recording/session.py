"""What every recording over DDS does alike: a node that listens until told, the rest of its queues, the account."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node

from ptnsbc_io.bag import BagWriter
from ptnsbc_nodes.runtime.executor import BoundedSpin, make_executor

_SLICE_S = 0.1  # Python sees a signal only between two calls of the executor
_QUIET_S = 0.2  # without a message: what was on its way has arrived


class RecordingSource(Protocol):
    """Subscriptions that write into a bag."""

    received: int
    lost: int  # as far as DDS reports it
    after_each: Callable[[], None]  # called after each message


@contextmanager
def listening_node(context: Context, name: str) -> Iterator[tuple[Node, Executor]]:
    """A node with nothing but subscriptions, and what serves it."""
    node = rclpy.create_node(
        name, context=context, start_parameter_services=False, enable_rosout=False
    )
    executor = make_executor(context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()


def listen(
    executor: Executor, hears: RecordingSource, over: Callable[[], bool], limit_s: float
) -> None:
    """Serve until it is over, then take in what is still in the queues, for so long at most."""
    slices = BoundedSpin(executor)
    hears.after_each = slices.look
    while not over():
        slices.serve(_SLICE_S)
    slices.drain(lambda: hears.received, _QUIET_S, limit_s)


def account(writer: BagWriter, hears: RecordingSource, **more: Any) -> Mapping[str, Any]:
    """What was recorded, once the bag is complete."""
    counts = writer.counts
    return {
        "bag": str(writer.directory),
        "messages": sum(counts.values()),
        "topics": counts,
        "lost": hears.lost,
        **more,
    }
