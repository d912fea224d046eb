"""A launcher in the network: which processes are ready, the services of the leader, word of lost processes.

Each part makes its topics and clients by `FleetNode.attach`, so that it has them again after the node has joined the
network anew. The commands of an operator use some of these parts, a launcher all of them (`LauncherNode`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from std_srvs.srv import Trigger

from ptnsbc_io.wire import (
    Diagnostics,
    HeaderFields,
    HeaderTemplate,
    decode_diagnostics,
    decode_header,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_leg, decode_lost
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.qos import RECORDER_RELIABLE
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import LOST, OVER, SIM
from ptnsbc_nodes.emergency import Order, VehicleRecord, reported, runtime_folder
from ptnsbc_nodes.runtime.node_process import BoundedSpin, plain_node
from ptnsbc_nodes.runtime.watchdog import WAITED, LockstepWait

_REQUEST_S = 1.0
_LOOK_S = 0.1
_ANEW_CALLS = 3  # so many calls without an answer, and the whole node joins the network again


class FleetNode:
    """One rclpy node of a fleet, in the network of its domain; use it as a context manager."""

    def __init__(
        self,
        domain: int,
        name: str = topics.LAUNCHER,
        namespace: str = "",
        ros_arguments: Sequence[str] = (),
        seal: Seal | None = None,
    ) -> None:
        self.domain, self.seal = domain, seal
        self._plain = partial(plain_node, name, ros_arguments, namespace, domain)
        self._joins: list[Callable[[], object]] = []
        self._join()

    def _join(self) -> None:
        self._joined = ExitStack()
        self.node, executor = self._joined.enter_context(self._plain())
        self.executor: Any = executor
        self._slices = BoundedSpin(executor)
        after = self._slices.look
        self.endpoints = Endpoints(self.node, lockstep=True, seal=self.seal, after=after)
        for join in self._joins:
            join()

    def attach(self, join: Callable[[], object]) -> None:
        """Call `join`, which makes topics and services, now and whenever the node joins the network again."""
        self._joins.append(join)
        join()

    def rejoin(self) -> None:
        """Leave the network and join it again: a discovery server may have left this node out."""
        self.leave()
        self._join()

    def leave(self) -> None:
        """Leave the network; again is no harm."""
        self._joined.close()

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        self._slices.serve(seconds)

    def sees(self, node: str) -> bool:
        """True if a node of this name is in the graph of ROS."""
        return node in self.node.get_node_names()

    @property
    def folder(self) -> Path:
        """The runtime folder of the fleet on this host."""
        return runtime_folder(self.domain, self.endpoints.fleet)


class FleetStatus:
    """Reports of the processes of a fleet."""

    def __init__(self, node: FleetNode) -> None:
        self.waiting: dict[str, str] = {}  # by process what for, empty when it is ready
        self.vehicles: dict[str, VehicleRecord] = {}  # by bridge
        self.places: dict[str, tuple[float, ...]] = {}  # by bridge, measured (3,) [m], ENU
        self.objections: dict[str, str] = {}  # by bridge, to arming its vehicle; empty without one
        self.last_s: dict[str, float] = {}  # by process the time of its last status, monotonic
        self._wait = LockstepWait()
        self._node = node
        node.attach(self._join)

    def _join(self) -> None:
        self._diagnostics, _ = (
            self._node.endpoints.listen(
                topic, decode_diagnostics, self._on_status, False, RECORDER_RELIABLE
            )
            for topic in (topics.DIAGNOSTICS, topics.READY)
        )

    def mute(self) -> None:
        """Hear /diagnostics no more: in flight it is not worth its reception."""
        self._node.endpoints.ignore(self._diagnostics)

    def missing(self, names: Iterable[str]) -> dict[str, str]:
        """Those of `names` that are not ready, and what each waits for."""
        waiting = {name: self.waiting.get(name, "its first diagnostics") for name in names}
        return {name: what for name, what in waiting.items() if what}

    def stuck(self) -> dict[str, float]:
        """Processes for which a lock-step flight waits in vain, and for how long [s]."""
        return self._wait.stuck(time.monotonic(), self.last_s)

    def _on_status(self, array: Diagnostics) -> None:
        now_s = time.monotonic()
        for status in array.statuses:
            values = status.values
            if "ready" not in values:
                continue
            name, waits_for = status.name.partition(":")[0], values.get("waiting_for", "")
            self.last_s[name] = now_s
            self.waiting[name] = "" if values["ready"] == "true" else waits_for or "something"
            if WAITED in values and name == SIM:
                self._wait.reported(now_s, waits_for.split(", ") if waits_for else [])
            if "order" in values:
                self.vehicles[name] = reported(name, values)
                self.objections[name] = values.get("objection", "")
                with suppress(ValueError):
                    place = tuple(map(float, values.get("position_m", "").split()))
                    if len(place) == 3 and all(map(math.isfinite, place)):
                        self.places[name] = place


class Answer(NamedTuple):
    """The answer to a call of a service of the leader, or of the launcher."""

    accepted: bool
    message: str
    found: bool = True  # somebody offers the service


class LeaderClient:
    """The services of the leader, /formation/NAME, and the epoch that it announces."""

    def __init__(self, node: FleetNode) -> None:
        self._node = node
        self._first_epoch_ns: int | None = None
        self._unanswered = 0
        node.attach(self._join)

    def _join(self) -> None:
        self._request = self._node.endpoints.publisher(topics.REQUEST, 1)
        self._start = self._client("start")

    def listen_for_start(self) -> None:
        """Hear of the first leg, when an operator starts the flight, or the mission begins by the clock."""

        def on_leg(leg: HeaderFields) -> None:
            if self._first_epoch_ns is None:
                self._first_epoch_ns = leg.stamp_ns

        def join() -> None:
            # Successors of the leader, of which we do not know, announce legs as well.
            self._node.endpoints.shared.add(topics.EPOCH.name)
            self._node.endpoints.listen(topics.EPOCH, decode_leg, on_leg, required=False)

        self._node.attach(join)

    @property
    def begun(self) -> bool:
        """True if a leg has been announced, after `listen_for_start`."""
        return self._first_epoch_ns is not None

    def begins_in_s(self) -> float:
        """The time left until the first leg begins by the wall clock; 0 when none was heard, and in lock-step."""
        return max(((self._first_epoch_ns or 0) - time.time_ns()) * 1e-9, 0.0)

    def start(self, patience_s: float) -> str | None:
        """Call /formation/start; returns why it did not work, None if it did.

        The network may have introduced only one of the two directions of a service: after a call without an answer
        it is met anew.
        """
        if not self._start.service_is_ready():
            self._node.spin(_LOOK_S)
            return not_there("start").message
        answer = self._ask(self._start, "start", patience_s)
        if answer is None:
            self._unanswered += 1
            if self._unanswered % _ANEW_CALLS == 0:
                self._node.rejoin()
            else:
                self._node.node.destroy_client(self._start)
                self._start = self._client("start")
            return _unanswered("start").message
        return None if answer.accepted else answer.message

    def call(self, name: str, patience_s: float) -> str | None:
        """As `ask`: why it did not work, None if it did."""
        answer = self.ask(name, patience_s)
        return None if answer.accepted else answer.message

    def ask(self, name: str, patience_s: float) -> Answer:
        """Call /formation/`name`, waiting until it is there."""
        client = self._client(name)
        deadline = time.monotonic() + patience_s
        while not client.service_is_ready() and time.monotonic() < deadline:
            self._node.spin(_LOOK_S)
        try:
            if not client.service_is_ready():
                return not_there(name)
            return self._ask(client, name, patience_s) or _unanswered(name)
        finally:
            self._node.node.destroy_client(client)

    def _client(self, name: str) -> Any:
        return self._node.node.create_client(
            Trigger, f"{self._node.endpoints.fleet}/formation/{name}"
        )

    def _ask(self, client: Any, name: str, patience_s: float) -> Answer | None:
        """None without an answer in time."""
        self._request(HeaderTemplate(name).encode(0))
        self._node.endpoints.flush(_REQUEST_S)
        call = client.call_async(Trigger.Request())
        self._node.executor.spin_until_future_complete(call, timeout_sec=patience_s)
        response = call.result() if call.done() else None
        return response and Answer(bool(response.success), str(response.message))


def not_there(name: str) -> Answer:
    """The answer where nobody offers the service."""
    return Answer(False, f"the leader's service /formation/{name} is not there", found=False)


def _unanswered(name: str) -> Answer:
    return Answer(False, f"the leader does not answer /formation/{name}")


class FleetNews:
    """Words of a launcher to the fleet, and of launchers of one fleet to each other: lost processes, and the end."""

    def __init__(self, node: FleetNode, *, shared: bool, leads: bool) -> None:
        """`shared`: other computers fly the rest of the fleet; `leads`: this launcher ends the flight."""
        self.gone: set[str] = set()  # processes that have ended on other computers
        self.over = False  # the launcher that leads has ended the flight
        self._node, self._shared, self._leads = node, shared, leads
        node.attach(self._join)

    def _join(self) -> None:
        endpoints = self._node.endpoints
        self._publish_lost = endpoints.publisher(LOST, 0)
        if not self._shared:
            return
        endpoints.listen(
            LOST, decode_lost, lambda process: self.gone.add(process.name), required=False
        )
        if self._leads:
            self._publish_over = endpoints.publisher(OVER, 0)
        else:
            endpoints.listen(OVER, decode_header, lambda _over: setattr(self, "over", True))

    def lose(self, name: str) -> None:
        """Tell all processes to wait for this process no longer."""
        self._publish_lost(HeaderTemplate(name).encode(0))

    def end(self, patience_s: float) -> None:
        """Tell all launchers that follow of the end, and wait until they have heard it."""
        if self._shared and self._leads:
            self._publish_over(HeaderTemplate(OVER.name).encode(0))
            self._node.endpoints.flush(patience_s)

    @property
    def led(self) -> bool:
        """True if the launcher that leads is there; only for a launcher that follows."""
        return full_name(self._node.node, OVER) not in self._node.endpoints.unheard()


class LauncherNode(FleetNode):
    """The node of a launcher, with all that a launcher does in the network."""

    def __init__(
        self, domain: int, *of_node: Any, shared: bool = False, leads: bool = True, **more: Any
    ) -> None:
        """As `FleetNode`; `shared` and `leads` are those of `FleetNews`."""
        super().__init__(domain, *of_node, **more)
        self.status = FleetStatus(self)
        self.news = FleetNews(self, shared=shared, leads=leads)
        self.leader = LeaderClient(self)
        self.attach(self._join_orders)

    def _join_orders(self) -> None:
        self._publish_order = self.endpoints.publisher(topics.EMERGENCY, 1)

    def send(self, order: Order) -> None:
        """Publish an order to all bridges, once."""
        self._publish_order(HeaderTemplate(order.text).encode(0))
