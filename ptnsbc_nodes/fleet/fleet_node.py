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

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.node import Node
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
from ptnsbc_nodes.comm.diagnostics import INACTIVE
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

_CONFIGURE, _ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
_STEPS = (_CONFIGURE, _ACTIVATE)
_TRANSITION_S = 5.0


class FleetNode:
    """One rclpy node of a fleet, in the network of its domain; use it as a context manager."""

    def __init__(
        self,
        domain: int,
        name: str = "fleet",
        namespace: str = "",
        ros_arguments: Sequence[str] = (),
        seal: Seal | None = None,
        within: Context | None = None,
    ) -> None:
        """`within`: a context that is there, instead of one of its own."""
        self.domain, self.seal = domain, seal
        self._plain = partial(plain_node, name, ros_arguments, namespace, domain, within)
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
        self.active: set[str] = set()  # processes whose nodes are active
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
            if INACTIVE not in waits_for:
                self.active.add(name)
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


class _ManagedTransitions:
    """One node on its way to active.

    A request may arrive without its answer: over a network that loses packets a discovery server may never introduce
    the client to the node. A transition without an answer may have happened, so the other one is tried next.
    """

    def __init__(self, node: Node, name: str, doubtful: bool, held: Callable[[], bool]) -> None:
        self._node, self._name, self._held = node, name, held
        self._client = self._new_client()
        self._steps = list(_STEPS)
        self._asked_s = float("-inf")
        self._call: Any = None
        self._doubtful = doubtful  # an answer may have been lost: a refusal then has no meaning
        self.refused = False

    @property
    def asked(self) -> bool:
        return self._asked_s > float("-inf")

    @property
    def done(self) -> bool:
        return not self._steps or self.refused

    def _may_ask(self) -> bool:
        return bool(self._steps) and not (self._steps[0] == _ACTIVATE and self._held())

    def look(self) -> None:
        """Request the next transition when no answer is awaited."""
        silent = time.monotonic() - self._asked_s > _TRANSITION_S
        if not self.done and silent and self._may_ask() and self._client.service_is_ready():
            if self._call is not None:
                self._doubtful = True
                self._turn()
                # The network may have introduced one direction only: a new client is introduced anew.
                self.close()
                self._client, self._call = self._new_client(), None
                return
            self._ask()

    def close(self) -> None:
        self._node.destroy_client(self._client)

    def _new_client(self) -> Any:
        return self._node.create_client(ChangeState, f"{self._name}/change_state")

    def _ask(self) -> None:
        request = ChangeState.Request()
        request.transition.id = self._steps[0]
        self._asked_s = time.monotonic()
        self._call = self._client.call_async(request)
        self._call.add_done_callback(self._on_answer)

    def _on_answer(self, call: Any) -> None:
        if call is not self._call or self.done:
            return
        self._call = None
        made = bool(call.result().success)
        self.refused = not (made or self._doubtful)
        if self.refused:
            return
        if made and self._steps[0] == _ACTIVATE:
            self._steps.clear()
        elif self._steps == [_ACTIVATE, _CONFIGURE]:  # not configured yet, or active already
            self._turn()
        else:
            self._steps.pop(0)
        if self._may_ask():
            self._ask()

    def _turn(self) -> None:
        if not self._held():  # whether or not it is configured, it is not asked to become active
            self._steps.append(self._steps.pop(0))


class LifecycleManager:
    """Takes any number of nodes to active; call `look` regularly."""

    def __init__(self, active: set[str]) -> None:
        """`active`: processes whose diagnostics say that they are active: they get no further request."""
        self.held: set[str] = set()  # processes whose nodes stay inactive while they are in there
        self.refused: list[str] = []  # those that refused a transition
        self._active = active
        self._managed: dict[str, str] = {}  # node by process
        self._nodes: dict[str, _ManagedTransitions] = {}

    def join(self, node: Node, fleet: str) -> None:
        """Ask from this node, in a fleet with this namespace; those that are managed may be on their way already."""
        self._node, self._fleet = node, fleet
        self._nodes.clear()
        for name in self._managed:
            self._begin(name, doubtful=True)

    def manage(self, name: str, node: str) -> None:
        """Take a node to active, from the beginning and as soon as it is there.

        `name` is that of its process, as on /diagnostics; `node` is below the fleet, `/uav3/controller`.
        """
        self._managed[name] = node
        self._active.discard(name)
        self._begin(name, doubtful=False)

    def _begin(self, name: str, *, doubtful: bool) -> None:
        if name in self._nodes:
            self._nodes[name].close()
        self._nodes[name] = _ManagedTransitions(
            self._node, self._fleet + self._managed[name], doubtful, lambda: name in self.held
        )

    def asked(self, name: str) -> bool:
        """True if a transition has been requested of the process."""
        return name not in self._nodes or self._nodes[name].asked

    def look(self) -> None:
        """Continue with all nodes that are not active yet."""
        for name, transitions in list(self._nodes.items()):
            if name not in self._active:
                transitions.look()
                if not transitions.done:
                    continue
            if transitions.refused:
                self.refused.append(name)
            transitions.close()
            del self._nodes[name]


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
        self.lifecycle = LifecycleManager(self.status.active)
        self.attach(self._join_parts)

    def _join_parts(self) -> None:
        self.lifecycle.join(self.node, self.endpoints.fleet)
        self._publish_order = self.endpoints.publisher(topics.EMERGENCY, 1)

    def send(self, order: Order) -> None:
        """Publish an order to all bridges, once."""
        self._publish_order(HeaderTemplate(order.text).encode(0))

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while, and take managed nodes on."""
        self.lifecycle.look()
        super().spin(seconds)
