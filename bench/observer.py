"""A subscriber beside a fleet: the values of all nodes on /diagnostics, and their times."""

from __future__ import annotations

import threading
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.topics import READY
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.executor import BoundedSpin, make_executor

_SLICE_S = 0.1


class Observer:
    """One node in a context and a thread of its own; use it as a context manager."""

    def __init__(self, domain: int) -> None:
        environment.prepare()
        self._raw: list[tuple[float, bytes]] = []
        self._over = threading.Event()
        self._context = Context()
        rclpy.init(
            context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self._node = rclpy.create_node(
            "bench", context=self._context, start_parameter_services=False, enable_rosout=False
        )
        for topic in (topics.DIAGNOSTICS, READY):
            self._node.create_subscription(
                DiagnosticArray, topic.name, self._on_status, 50, raw=True
            )
        self._executor = make_executor(self._context)
        self._executor.add_node(self._node)
        self._slices = BoundedSpin(self._executor)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Observer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._slices.serve(0.0)
        self._node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)

    def newest(self) -> dict[str, dict[str, str]]:
        """The last values of every node, by the name before the colon."""
        return {
            status.name.partition(":")[0]: status.values
            for _, data in list(self._raw)
            for status in decode_diagnostics(data).statuses
        }

    def first_at(self) -> float | None:
        """The time of the first status [s], monotonic; None before it."""
        return self._raw[0][0] if self._raw else None

    def _on_status(self, data: bytes) -> None:
        self._raw.append((time.monotonic(), data))

    def _run(self) -> None:
        while not self._over.is_set():
            self._slices.serve(_SLICE_S)
