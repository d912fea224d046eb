"""The launcher's own node: which processes are ready, the start of the flight, and word of lost processes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from ptnsbc_io.wire import (
    Diagnostics,
    HeaderFields,
    HeaderTemplate,
    Stamped,
    decode_diagnostics,
    decode_header,
    decode_odometry,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import (
    ARM_SERVICE,
    LostProcess,
    OrderedFault,
    Requests,
    decode_leg,
    decode_lost,
    encode_fault,
    fault_decoder,
)
from ptnsbc_nodes.comm.diagnostics import INACTIVE
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.qos import RECORDER_RELIABLE, STATE_REALTIME
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import LOST, OVER, READY, SIM
from ptnsbc_nodes.emergency.orders import Order, runtime_folder
from ptnsbc_nodes.emergency.records import VehicleRecord, reported
from ptnsbc_nodes.fleet.lifecycle_manager import LifecycleManager
from ptnsbc_nodes.runtime.node_process import make_executor
from ptnsbc_nodes.runtime.watchdog import WAITED, LockstepWait
from ptnsbc_sim.scenario.mission.faults import FaultBlock

_REQUEST_S = 1.0
_LISTENERS_S = 2.0  # without a further listener to faults: all are discovered
_SIGN_OF_LIFE_S = 2.0  # a process that is kept waiting says so five times a second
_ANEW_CALLS = 3  # so many calls without an answer, and the whole node joins the network again
_LOOK_S = 0.05


def not_there(service: str) -> str:
    """The words for a service of the leader that nobody offers."""
    return f"the leader's service /formation/{service} is not there"


class Coordinator:
    """One rclpy node in a context of its own; use it as a context manager."""

    def __init__(
        self,
        domain: int,
        name: str = "fleet",
        namespace: str = "",
        ros_arguments: Sequence[str] = (),
        seal: Seal | None = None,
    ) -> None:
        self.domain = domain
        self.gone: set[str] = set()  # processes that have ended on other computers
        self.over = False  # the launcher that leads has ended the flight
        self._first_epoch_ns: int | None = None  # of the first leg, after `listen_for_start`
        self.waiting: dict[str, str] = {}  # process name: what it waits for, empty when ready
        self.vehicles: dict[str, VehicleRecord] = {}  # by bridge: what it reported of its vehicle
        self._name, self._ros_arguments = name, list(ros_arguments)
        self._namespace = namespace
        self._seal = seal
        self._leads: bool | None = None  # where the fleet is shared
        self._listens_for_start = False
        self.may_arm = False  # an operator has called /formation/arm, and it was accepted
        self._arming: Callable[[], str] | None = None
        self._listen_for_faults: Callable[[], str] | None = None
        self._managed: dict[str, str] = {}  # node by process name
        self.held: set[str] = set()
        """Processes whose nodes are configured and not activated."""
        self.places: dict[str, tuple[float, ...]] = {}
        """Measured position (3,) [m], ENU, of each vehicle, by bridge, before the flight."""
        self._last_status_s: dict[str, float] = {}  # when each process sent its last status
        self._wait = LockstepWait()
        self._answers = self._unanswered = 0  # calls of services
        self._join()

    def _join(self) -> None:
        self._publish_over: Callable[[bytes], None] | None = None
        self._context = Context()
        rclpy.init(
            args=self._ros_arguments,
            context=self._context,
            domain_id=self.domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(
            self._name,
            namespace=self._namespace,
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._executor: Any = make_executor(self._context)
        self._executor.add_node(self._node)
        self._endpoints = Endpoints(self._node, lockstep=True, seal=self._seal)
        self._publish_request = self._endpoints.publisher(topics.REQUEST, 1)
        self._publish_lost = self._endpoints.publisher(LOST, 0)
        self._publish_emergency = self._endpoints.publisher(topics.EMERGENCY, 1)
        self._manager = LifecycleManager(self._node, self.held)
        self._start = self._client("start")
        self._diagnostics, _ = (
            self._endpoints.listen(
                topic, decode_diagnostics, self._on_status, False, RECORDER_RELIABLE
            )
            for topic in (topics.DIAGNOSTICS, READY)
        )

    def rejoin(self) -> None:
        """Leave the network and join it again: a discovery server may have left this node out."""
        self.leave()
        self._join()
        if self._leads is not None:
            self.share(leads=self._leads)
        if self._listens_for_start:
            self.listen_for_start()
        if self._arming is not None:
            self.serve_arming(self._arming)
        if self._listen_for_faults is not None:
            self._listen_for_faults()
        for name, node in self._managed.items():
            self._manager.manage(name, self._endpoints.fleet + node, doubtful=True)

    def share(self, *, leads: bool) -> None:
        """Hear of ends on other computers; publish the end of the flight, or hear of it."""
        self._leads = leads
        self._endpoints.listen(LOST, decode_lost, self._on_lost, required=False)
        if leads:
            self._publish_over = self._endpoints.publisher(OVER, 0)
        else:
            self._endpoints.listen(OVER, decode_header, self._on_over)

    def listen_for_start(self) -> None:
        """Hear of the first leg, when an operator starts the flight, or the mission begins by the clock."""
        self._listens_for_start = True
        self._endpoints.shared.add(
            topics.EPOCH.name
        )  # with successors of the leader, of which we do not know
        self._endpoints.listen(topics.EPOCH, decode_leg, self._on_leg, required=False)

    @property
    def begun(self) -> bool:
        """True if a leg has been announced, after `listen_for_start`."""
        return self._first_epoch_ns is not None

    def begins_in_s(self) -> float:
        """The time left until the first leg begins by the wall clock; 0 when none was heard, and in lock-step."""
        return max(((self._first_epoch_ns or 0) - time.time_ns()) * 1e-9, 0.0)

    def serve_arming(self, refusal: Callable[[], str]) -> None:
        """Answer /formation/arm; `refusal` says why the vehicles must not arm, or nothing."""
        self._arming = refusal
        requests = Requests(self._endpoints, (ARM_SERVICE,), signed=self._seal is not None)

        def answer(_request: Any, response: Any) -> Any:
            reason = requests.refusal(ARM_SERVICE) or refusal()
            response.success = not reason
            response.message = reason or "the vehicles arm, and take off"
            self.may_arm = self.may_arm or not reason
            return response

        self._node.create_service(
            Trigger, f"{self._endpoints.fleet}/formation/{ARM_SERVICE}", answer
        )

    def listen_for_faults(self, uavs: Collection[int], take: Callable[[FaultBlock], None]) -> None:
        """Hear of the faults that an operator injects into a fleet of these UAVs."""

        def heard(order: OrderedFault) -> None:
            take(order.fault)

        self._listen_for_faults = lambda: self._endpoints.listen(
            topics.FAULT, fault_decoder(uavs), heard, required=False
        )
        self._listen_for_faults()

    def inject(self, fault: FaultBlock, patience_s: float) -> int:
        """Tell a running fleet of a fault, once; returns how many processes listened, after at most this time."""
        publish = self._endpoints.publisher(topics.FAULT, 1)
        count = self._endpoints.readers(topics.FAULT)
        deadline_s = time.monotonic() + patience_s
        found = count()
        while time.monotonic() < deadline_s:
            self.spin(_LISTENERS_S)
            if found and count() == found:  # no further one has been discovered for a while
                break
            found = count()
        if found:
            publish(encode_fault(time.time_ns(), fault))
            self._endpoints.flush(patience_s)
        return found

    @property
    def led(self) -> bool:
        """True if the launcher that leads is there; only for a launcher that follows."""
        return full_name(self._node, OVER) not in self._endpoints.unheard()

    def end(self, patience_s: float) -> None:
        """Tell all launchers that follow of the end, and wait until they have heard it."""
        if self._publish_over is not None:
            self._publish_over(HeaderTemplate(OVER.name).encode(0))
            self._endpoints.flush(patience_s)

    def runtime_folder(self) -> Path:
        """The folder of the fleet on this host."""
        return runtime_folder(self.domain, self._endpoints.fleet)

    def __enter__(self) -> Coordinator:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def leave(self) -> None:
        """Leave the network; again is no harm."""
        if not self._context.ok():
            return
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def manage(self, name: str, node: str) -> None:
        """Configure and activate the node of the process `name`, as soon as it is there.

        Args:
            name: As on /diagnostics.
            node: Its name below the namespace of the fleet, `/uav3/controller`.
        """
        self._managed[name] = node
        self._manager.manage(name, self._endpoints.fleet + node)

    def asked(self, name: str) -> bool:
        """True if a transition has been requested of the managed process."""
        return self._manager.asked(name)

    def sees(self, node: str) -> bool:
        """True if a node of this name is in the graph of ROS."""
        return node in self._node.get_node_names()

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
            return not_there("start")
        answers = self._answers
        refusal = self._answer(self._start, "start", patience_s)
        if self._answers == answers:
            self._start_anew()
        if refusal is None:
            self._endpoints.ignore(self._diagnostics)  # in flight not worth its reception
        return refusal

    def _start_anew(self) -> None:
        """Meet the leader's service anew: the network may have introduced only one of its two directions."""
        self._unanswered += 1
        if self._unanswered % _ANEW_CALLS == 0:
            self.rejoin()
        else:
            self._node.destroy_client(self._start)
            self._start = self._client("start")

    def positions(self, uav_ids: Iterable[int], patience_s: float) -> dict[int, tuple[float, ...]]:
        """Measured positions (3,) [m], ENU, in real time; without the UAVs that publish none in this time."""
        found: dict[int, tuple[float, ...]] = {}

        def keep(uav: int) -> Callable[[Stamped], None]:
            def on_odometry(own: Stamped) -> None:
                found[uav] = tuple(float(number) for number in own.values[:3])

            return on_odometry

        wanted = tuple(uav_ids)
        heard = [
            self._endpoints.listen(
                topics.odom(uav), decode_odometry, keep(uav), False, STATE_REALTIME
            )
            for uav in wanted
        ]
        deadline = time.monotonic() + patience_s
        while len(found) < len(wanted) and time.monotonic() < deadline:
            self.spin(_LOOK_S)
        for name in heard:
            self._endpoints.ignore(name)
        return found

    def stuck(self) -> dict[str, float]:
        """Processes that have kept a lock-step flight waiting and give no sign of life, and for how long [s]."""
        now_s = time.monotonic()
        since_s = now_s - _SIGN_OF_LIFE_S
        return {
            name: waited_s
            for name, waited_s in self._wait.at(now_s).items()
            if self._last_status_s.get(name, 0.0) < since_s
        }

    def last_status_s(self, name: str) -> float | None:
        """The time at which a process sent its last status [s], by the monotonic clock; None: no status was heard."""
        return self._last_status_s.get(name)

    def call(self, name: str, patience_s: float) -> str | None:
        """Call /formation/`name`, waiting until it is there; returns why it did not work."""
        done, said = self.ask(name, patience_s)
        return None if done else said

    def ask(self, name: str, patience_s: float) -> tuple[bool, str]:
        """Call /formation/`name`, waiting until it is there: whether it worked, and what the leader says."""
        client = self._client(name)
        deadline = time.monotonic() + patience_s
        while not client.service_is_ready() and time.monotonic() < deadline:
            self.spin(0.1)
        try:
            if not client.service_is_ready():
                return False, not_there(name)
            return self._asked(client, name, patience_s)
        finally:
            self._node.destroy_client(client)

    def send(self, order: Order) -> None:
        """Publish an order to all bridges, once; `EmergencyStop` repeats it until all have answered."""
        self._publish_emergency(HeaderTemplate(order.text).encode(0))

    def lose(self, name: str) -> None:
        """Tell all processes to wait for this process no longer."""
        self._publish_lost(HeaderTemplate(name).encode(0))

    def _client(self, name: str) -> Any:
        return self._node.create_client(Trigger, f"{self._endpoints.fleet}/formation/{name}")

    def _answer(self, client: Any, name: str, patience_s: float) -> str | None:
        done, said = self._asked(client, name, patience_s)
        return None if done else said

    def _asked(self, client: Any, name: str, patience_s: float) -> tuple[bool, str]:
        self._publish_request(HeaderTemplate(name).encode(0))
        self._endpoints.flush(_REQUEST_S)
        call = client.call_async(Trigger.Request())
        self._executor.spin_until_future_complete(call, timeout_sec=patience_s)
        response = call.result() if call.done() else None
        self._answers += response is not None
        if response is None:
            return False, f"the leader does not answer /formation/{name}"
        return bool(response.success), str(response.message)

    def _on_lost(self, process: LostProcess) -> None:
        self.gone.add(process.name)

    def _on_leg(self, leg: HeaderFields) -> None:
        if self._first_epoch_ns is None:
            self._first_epoch_ns = leg.stamp_ns

    def _on_over(self, _over: HeaderFields) -> None:
        self.over = True

    def _on_status(self, array: Diagnostics) -> None:
        for status in array.statuses:
            values = status.values
            if "ready" in values:
                name, waits_for = status.name.partition(":")[0], values.get("waiting_for", "")
                self._last_status_s[name] = time.monotonic()
                if INACTIVE not in waits_for:
                    self._manager.arrived(name)
                if WAITED in values and name == SIM:
                    self._wait.reported(
                        time.monotonic(), waits_for.split(", ") if waits_for else []
                    )
                if "order" in values:
                    self.vehicles[name] = reported(name, values)
                    self._on_place(name, values.get("position_m", ""))
                self.waiting[name] = "" if values["ready"] == "true" else waits_for or "something"

    def _on_place(self, name: str, text: str) -> None:
        with suppress(ValueError):
            place = tuple(map(float, text.split()))
            if len(place) == 3 and all(map(math.isfinite, place)):
                self.places[name] = place
