"""The launcher's own node: who is ready, the start, and word of those who are lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from ptnsbc_io.wire import HeaderTemplate, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import INACTIVE
from ptnsbc_nodes.comm.endpoints import LOST, OVER, READY, Endpoints, full_name
from ptnsbc_nodes.fleet.lifecycle_manager import LifecycleManager
from ptnsbc_nodes.runtime.executor import make_executor
from ptnsbc_nodes.runtime.watchdog import ENDED_S, WAITED

_SIGN_OF_LIFE_S = 2.0  # who is kept waiting tells it five times a second


class Coordinator:
    """One rclpy node in a context of its own; use it as a context manager."""

    def __init__(self, domain: int, name: str = "fleet", ros_arguments: Sequence[str] = ()) -> None:
        self.gone: set[str] = set()  # processes that have ended on other computers
        self.over = False  # said by the launcher that leads
        self._tell_over: Callable[[bytes], None] | None = None
        self.waiting: dict[str, str] = {}  # process name: what it waits for, empty when ready
        self._context = Context()
        rclpy.init(
            args=list(ros_arguments),
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(
            name, context=self._context, start_parameter_services=False, enable_rosout=False
        )
        self._executor: Any = make_executor(self._context)
        self._executor.add_node(self._node)
        self._ends = Endpoints(self._node, lockstep=True)
        self._tell_lost = self._ends.publisher(LOST, 0)
        self._tell_bridges = self._ends.publisher(topics.EMERGENCY, 1)
        self._manager = LifecycleManager(self._node)
        self._start = self._node.create_client(Trigger, f"{self._ends.fleet}/formation/start")
        self._heard_s: dict[str, float] = {}  # when each process was heard of last
        self._kept_waiting = (0.0, "")  # for how long, by whom: from the sim, newest
        hear = self._node.create_subscription
        self._ear: Any = hear(DiagnosticArray, topics.DIAGNOSTICS.name, self._on_status, 50)
        hear(DiagnosticArray, full_name(self._node, READY), self._on_status, 50)

    def share(self, *, leads: bool) -> None:
        """Hear who ends on other computers; tell of the end of the flight, or hear of it."""
        self._ends.listen(LOST, self._on_lost, required=False)
        if leads:
            self._tell_over = self._ends.publisher(OVER, 0)
        else:
            self._ends.listen(OVER, self._on_over)

    @property
    def led(self) -> bool:
        """Whether the launcher that leads is there; only for one that follows."""
        return full_name(self._node, OVER) not in self._ends.unheard()

    def end(self, patience_s: float) -> None:
        """Tell all launchers that follow of the end, and wait until they have heard it."""
        if self._tell_over is not None:
            self._tell_over(HeaderTemplate(OVER.name).encode(0))
            self._ends.flush(patience_s)

    def __enter__(self) -> Coordinator:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self.spin(0.0)  # the EventsExecutor lets go of a node only when it runs the next time
        self._node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)

    def manage(self, name: str, node: str) -> None:
        """Configure and activate the node of the process `name`, as soon as it is there.

        Args:
            name: As on /diagnostics.
            node: Its name below the namespace of the fleet, `/uav3/controller`.
        """
        self._manager.manage(name, self._ends.fleet + node)

    @property
    def refused(self) -> list[str]:
        """Processes whose nodes refused to be configured or activated."""
        return self._manager.refused

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        self._manager.look()
        self._executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def missing(self, names: Iterable[str]) -> dict[str, str]:
        """Those of `names` that are not ready, and what each waits for."""
        waiting = {name: self.waiting.get(name, "its first diagnostics") for name in names}
        return {name: what for name, what in waiting.items() if what}

    def start(self, patience_s: float) -> str | None:
        """Call /formation/start; returns why it did not work, None if it did."""
        if not self._start.service_is_ready():
            self.spin(0.1)
            return "the leader's service /formation/start is not there"
        refusal = self._answer(self._start, "start", patience_s)
        if refusal is None and self._ear is not None:
            self._node.destroy_subscription(self._ear)  # in flight not worth its reception
            self._ear = None
        return refusal

    def stuck(self) -> list[str]:
        """Processes that have kept a lock-step flight waiting for too long, and give no sign of life."""
        (waited_s, names), self._kept_waiting = self._kept_waiting, (0.0, "")
        if waited_s < ENDED_S:
            return []
        since_s = time.monotonic() - _SIGN_OF_LIFE_S
        return [name for name in names.split() if self._heard_s.get(name, 0.0) < since_s]

    def call(self, name: str, patience_s: float) -> str | None:
        """Call /formation/`name`, waiting until it is there; returns why it did not work."""
        client = self._node.create_client(Trigger, f"{self._ends.fleet}/formation/{name}")
        deadline = time.monotonic() + patience_s
        while not client.service_is_ready() and time.monotonic() < deadline:
            self.spin(0.1)
        try:
            if not client.service_is_ready():
                return f"the leader's service /formation/{name} is not there"
            return self._answer(client, name, patience_s)
        finally:
            self._node.destroy_client(client)

    def emergency(self, what: str, patience_s: float = 2.0) -> bool:
        """Tell all bridges to `land` or `kill`, without the leader; False when none listens."""
        deadline = time.monotonic() + patience_s
        emergency = full_name(self._node, topics.EMERGENCY)
        while emergency in self._ends.unread() and time.monotonic() < deadline:
            self.spin(0.1)
        heard = emergency not in self._ends.unread()
        self._tell_bridges(HeaderTemplate(what).encode(0))
        self._ends.flush(1.0)
        return heard

    def _answer(self, client: Any, name: str, patience_s: float) -> str | None:
        call = client.call_async(Trigger.Request())
        self._executor.spin_until_future_complete(call, timeout_sec=patience_s)
        response = call.result() if call.done() else None
        if response is None:
            return f"the leader does not answer /formation/{name}"
        return None if response.success else str(response.message)

    def lose(self, name: str) -> None:
        """Tell everybody to wait for this process no longer."""
        self._tell_lost(HeaderTemplate(name).encode(0))

    def _on_lost(self, data: bytes) -> None:
        self.gone.add(decode_header(data).frame_id)

    def _on_over(self, _data: bytes) -> None:
        self.over = True

    def _on_status(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "ready" in values:
                ready = values["ready"] == "true"
                name = status.name.partition(":")[0]
                self._heard_s[name] = time.monotonic()
                if INACTIVE not in values.get("waiting_for", ""):
                    self._manager.arrived(name)
                if WAITED in values:
                    self._kept_waiting = (float(values[WAITED]), values["waiting_for"])
                self.waiting[name] = "" if ready else values.get("waiting_for", "") or "something"
