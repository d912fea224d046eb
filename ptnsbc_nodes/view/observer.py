"""The node of a viewer: subscriptions that nobody waits for, and the leader's services on request."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from functools import partial

from rcl_interfaces.srv import GetParameters

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import Diagnostics, OdometryDecoder, decode_diagnostics, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_leg, decode_lost
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.qos import STATE_REALTIME, keep_last
from ptnsbc_nodes.comm.seal import operators_seal, seal_of
from ptnsbc_nodes.fleet.fleet_node import FleetNode, LeaderClient
from ptnsbc_nodes.runtime.node_parameters import SCENARIO
from ptnsbc_nodes.view.flight_state import FlightState, scenario_of
from ptnsbc_sim.scenario import Scenario

LEGS = ("hold", "land", "stop")
"""The services of the leader that a viewer may call."""
_CONTROLLER = re.compile(r"(.*)/uav(\d+)")
_LOOK_S = 0.1
_ANSWER_S = 3.0


class FleetListener:
    """Subscriptions to what the processes of a fleet tell, on its way into a `FlightState`; nobody waits for them."""

    def __init__(self, endpoints: Endpoints, state: FlightState) -> None:
        self._state, self._hears_vehicles = state, False
        self._listen = partial(endpoints.listen, required=False)
        scenario, processes = state.scenario, state.processes
        if scenario.formation.reconfigures:  # a successor of the leader announces the legs as well
            endpoints.shared.add(topics.EPOCH.name)
        often = keep_last(10 * len(scenario.uav_ids), reliable=True)
        for topic in (topics.DIAGNOSTICS, topics.READY):
            self._listen(topic, decode_diagnostics, processes.on_status, profile=often)
        self._listen(topics.EPOCH, decode_leg, state.on_leg)
        self._listen(topics.LOST, decode_lost, processes.on_lost)
        self._listen(topics.OVER, decode_header, lambda _over: setattr(processes, "over", True))
        if scenario.takes_setpoints:
            self._listen(topics.TAKEN, OdometryDecoder(), state.on_taken)
        if scenario.formation.has_open_slots:
            self._listen(topics.SLOTS, state.decided.decode, state.on_slots)

    def look(self) -> None:
        """Subscribe to odometry once the flight has begun.

        Not before the start: vehicles wait for so many readers, and not for a viewer.
        """
        if self._hears_vehicles or not self._state.epochs.announced:
            return
        self._hears_vehicles = True
        for uav in self._state.scenario.uav_ids:
            # Neither the frames nor the order of stamps matter to a viewer.
            take = partial(self._state.on_odometry, uav)
            for topic in (topics.odom(uav), topics.track(uav)):  # the latter once it has left
                self._listen(topic, OdometryDecoder(), take, profile=STATE_REALTIME)


class Observer(FleetNode):
    """A node that looks at a fleet; use it as a context manager. Several viewers may look at one fleet."""

    def __init__(self, domain: int, namespace: str = "", name: str = "view") -> None:
        super().__init__(domain, name, namespace)
        self._leader: LeaderClient | None = None
        self._listener: FleetListener | None = None

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while."""
        super().spin(seconds)
        if self._listener is not None:
            self._listener.look()

    def scenario(self, patience_s: float, stopped: Callable[[], bool]) -> Scenario:
        """The scenario of the fleet, from one of its UAVs or bridges.

        Raises:
            PtnsbcError: no UAV answers in this time, or `stopped` says so.
            PtnsbcError: its scenario cannot be read on this computer.
        """
        end = time.monotonic() + patience_s
        while time.monotonic() < end and not stopped():
            for name, namespace in self.node.get_node_names_and_namespaces():
                found = _CONTROLLER.fullmatch(namespace)
                ours = found and found[1] == self.endpoints.fleet
                if ours and name in ("controller", "bridge"):  # UAVs start when vehicles may arm
                    text = self._text(f"{namespace}/{name}", end)
                    if text is not None:
                        return scenario_of(text)
            self.spin(_LOOK_S)
        raise PtnsbcError(
            f"domain {self.domain}: no UAV answers: expected a fleet there, or the domain that "
            "`ptnsbc fleet` printed: --domain N"
        )

    def _text(self, node: str, end: float) -> str | None:
        client = self.node.create_client(GetParameters, f"{node}/get_parameters")
        try:
            while not client.service_is_ready() and time.monotonic() < end:
                self.spin(_LOOK_S)
            request = GetParameters.Request(names=[SCENARIO])
            call = client.call_async(request)
            self.executor.spin_until_future_complete(call, timeout_sec=_ANSWER_S)
            answer = call.result() if call.done() else None
            if answer is None or len(answer.values) != 1:
                return None
            return str(answer.values[0].string_value)
        finally:
            self.node.destroy_client(client)

    def watch(self, scenario: Scenario) -> FlightState:
        """Subscribe to what a viewer shows; the state that is kept up to date from now on."""
        state = FlightState(scenario, time.monotonic)
        seal = seal_of(scenario) or operators_seal()
        self.endpoints = Endpoints(self.node, lockstep=True, seal=seal, after=self._slices.look)
        self._leader = LeaderClient(self)
        self._listener = FleetListener(self.endpoints, state)
        return state

    def ailments(self, names: Sequence[str], patience_s: float) -> dict[str, str]:
        """Faults of processes of the fleet: those that are silent for so long, or report an error.

        A recorder has no status: it counts as well while its node is there.
        """
        heard: dict[str, str] = {}

        def on_status(array: Diagnostics) -> None:
            for status in array.statuses:
                name = status.name.partition(":")[0]
                ails = status.level >= DiagnosticLevel.ERROR
                heard[name] = (status.message or "an error") if ails else ""

        seal, after = operators_seal(), self._slices.look
        endpoints = Endpoints(self.node, lockstep=False, seal=seal, after=after)
        for topic in (topics.DIAGNOSTICS, topics.READY):
            endpoints.listen(topic, decode_diagnostics, on_status, required=False)
        end = time.monotonic() + patience_s
        while not heard.keys() >= set(names) and time.monotonic() < end:
            self.spin(_LOOK_S)
            if topics.RECORDER in self.node.get_node_names():
                heard[topics.RECORDER] = ""
        endpoints.close()
        found = {name: heard.get(name, "silent") for name in names}
        return {name: what for name, what in found.items() if what}

    def call(self, leg: str) -> str:
        """Call the leader's service for a leg; returns why it did not work, empty when it did."""
        assert leg in LEGS and self._leader is not None
        return self._leader.call(leg, _ANSWER_S) or ""
