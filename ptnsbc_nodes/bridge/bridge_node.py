"""The bridge on ROS 2: topics in and out around `Bridge`, which runs in a thread of its own.

The thread of the node only stores messages as inputs of the bridge. The thread of the bridge decides and sends
everything, so that a busy executor never delays the stream.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.autopilots import SetpointLimits
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import (
    Diagnostics,
    HeaderTemplate,
    OdometryDecoder,
    OdometryTemplate,
    Stamped,
    checked_velocity,
    checked_wrench,
    decode_diagnostics,
    encode_near,
)
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.status import OrderDesk, bridge_status, companion
from ptnsbc_nodes.bridge.vehicle_monitor import Battery
from ptnsbc_nodes.comm import topics, vehicle_messages
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, LiveTransforms, body_frame
from ptnsbc_nodes.comm.announcements import decode_leg, decode_order
from ptnsbc_nodes.comm.diagnostics import StatusLog
from ptnsbc_nodes.comm.door import as_bytes
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.emergency import APART, LAND, Order, RuntimeFolderError, runtime_folder
from ptnsbc_nodes.runtime.environment import named_domain
from ptnsbc_nodes.runtime.pacing import clock_of
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import PlannerLimits

_BRIDGE, _LINK = "bridge", ": link"
_NOT_OURS = (Step.YIELDED, Step.HEARTBEAT, Step.DONE, Step.FAILED)


class BridgeOptions(NamedTuple):
    """The options that are settled at the start of the process."""

    allow_arming: bool
    with_fleet: bool = False
    """True if every other UAV of the scenario has a bridge, which must be ready as well."""
    signing_key: str = ""
    """Path of the key file: `ptnsbc stop` reaches the vehicle with it when this process is dead."""


class _TopicPorts(BridgePorts):
    """The words of a bridge to others, as topics and as lines on stderr."""

    def __init__(
        self, node: Node, endpoints: Endpoints, scenario: Scenario, uav_id: int, recorders: int
    ) -> None:
        publisher = endpoints.publisher
        super().__init__(time.monotonic, clock_of(node))
        self._uav_id = uav_id
        self._odometry = OdometryTemplate(WORLD_FRAME, body_frame(uav_id, endpoints.fleet))
        self._send_odom = publisher(topics.odom(uav_id), 1 + recorders)
        self._send_track = publisher(topics.track(uav_id), 0)
        self._send_truth = publisher(topics.truth(uav_id), 0)
        self._send_limits = publisher(topics.limits(uav_id), 1)
        self._send_battery = publisher(topics.battery(uav_id), 0)
        leads = uav_id == scenario.leader.id
        self._send_origin = publisher(topics.ORIGIN, 0) if leads else None
        self._send_lost = publisher(topics.LOST, 0)
        self._send_order = publisher(topics.EMERGENCY, 0)
        self._transforms = LiveTransforms(endpoints, [uav_id])

    def odom(self, stamp_ns: int, odometry: Array) -> None:
        data = self._odometry.encode(stamp_ns, odometry)
        self._send_odom(data)
        self._transforms.publish(self._uav_id, data)

    def track(self, stamp_ns: int, odometry: Array) -> None:
        self._send_track(self._odometry.encode(stamp_ns, odometry))

    def truth(self, stamp_ns: int, odometry: Array) -> None:
        self._send_truth(self._odometry.encode(stamp_ns, odometry))

    def origin(self, place: GeoPoint) -> None:
        if self._send_origin is not None:
            self._send_origin(vehicle_messages.encode_origin(place))

    def limits(self, limits: SetpointLimits) -> None:
        planner = PlannerLimits(limits.planner_m_s, limits.acceleration_m_s2)
        self.log("planner: at most {:g} m/s, {:g} m/s^2".format(*planner))
        self._send_limits(vehicle_messages.encode_limits(planner))

    def battery(self, battery: Battery) -> None:
        self._send_battery(vehicle_messages.encode_battery(self.ros_ns(), *battery))

    def lost(self) -> None:
        self._send_lost(HeaderTemplate(f"uav{self._uav_id}").encode(0))

    def apart(self) -> None:
        self._send_order(HeaderTemplate(APART).encode(0))

    def log(self, line: str) -> None:
        print(f"bridge{self._uav_id}: {line}", file=sys.stderr, flush=True)


class FleetReports:
    """The statuses of the UAV process and of the other bridges, before arming.

    In flight nothing reads the diagnostics of others, so they are not worth their reception.
    """

    def __init__(
        self, endpoints: Endpoints, scenario: Scenario, uav_id: int, ports: BridgePorts
    ) -> None:
        self._endpoints, self._ports = endpoints, ports
        self._planner = f"uav{uav_id}: planner"
        self._numbers = frozenset(map(str, scenario.uav_ids))
        profile = keep_last(20, reliable=True)
        self._heard = endpoints.listen(
            topics.DIAGNOSTICS, self._decode, self._on_diagnostics, required=False, profile=profile
        )

    def close(self) -> None:
        """Hear no more of them."""
        self._endpoints.ignore(self._heard)

    def _decode(self, data: bytes) -> Diagnostics | None:
        """The statuses of the UAV process and of bridges; None for others, which are not worth decoding."""
        wanted = self._planner.encode() in data or _LINK.encode() in data
        return decode_diagnostics(data) if wanted else None

    def _on_diagnostics(self, array: Diagnostics | None) -> None:
        inputs, now_s = self._ports.inputs, self._ports.steady_s()
        for status in array.statuses if array is not None else ():
            name, values = status.name, status.values
            if name == self._planner:
                inputs.controller_ready = values.get("ready") == "true"
                inputs.controller_heard_s = now_s
            elif name.startswith(_BRIDGE) and name.endswith(_LINK):
                number = name.removeprefix(_BRIDGE).removesuffix(_LINK)
                report = companion(values)
                if report is not None and number in self._numbers:
                    inputs.companions.append((int(number), report, now_s))


class NearPublisher:
    """Publishes the near objects of one UAV, from the scenario and from the odometry of other UAVs.

    It hears all of them, because its bridge gives the formation up for any that comes too near, and lands above any.
    """

    def __init__(
        self, endpoints: Endpoints, scenario: Scenario, uav_id: int, edges: CommunicationGraph
    ) -> None:
        self._objects = NearObjects(scenario, uav_id, edges.linked(uav_id))
        self._period_s = 1.0 / scenario.sensor.rate_hz
        self._next_s = 0.0
        self._send = endpoints.publisher(topics.near(uav_id), 1 + edges.options.recorders)
        for other in sorted(set(scenario.uav_ids) - {uav_id}):
            for topic, left in ((topics.odom(other), False), (topics.track(other), True)):
                hear = partial(self._on_odometry, other, left)
                endpoints.listen(topic, OdometryDecoder(), hear, required=False)

    def _on_odometry(self, uav_id: int, left: bool, message: Stamped) -> None:
        self._objects.on_odometry(uav_id, time.monotonic(), message.values, left=left)

    def publish_due(self, bridge: Bridge) -> None:
        """Publish at the rate of the scenario's sensor, once the bridge knows its own odometry."""
        now_s, odometry = time.monotonic(), bridge.state_publisher.odometry
        if odometry is None or now_s < self._next_s:
            return
        self._next_s = now_s + self._period_s
        bridge.ports.inputs.near_uavs = self._objects.uavs(now_s)
        rows = self._objects.rows(now_s, odometry[0:3], bridge.flight_s())
        self._send(encode_near(bridge.ports.ros_ns(), WORLD_FRAME, rows))


class BridgeNode:
    """One bridge as one rclpy node; it sends nothing to the vehicle until `start`.

    It calls `on_end` when the flight is over, with its faults, or without any the step in which it ended.
    """

    def __init__(
        self,
        node: Node,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
        link: MavlinkLink,
        options: BridgeOptions,
        on_end: Callable[[str], None],
    ) -> None:
        self.node, self._name, self._on_end = node, f"bridge{uav_id}", on_end
        self.endpoints = Endpoints(node, lockstep=False, seal=edges.options.seal)
        recorders = edges.options.recorders
        self._ports = ports = _TopicPorts(node, self.endpoints, scenario, uav_id, recorders)
        awaited = frozenset(scenario.uav_ids) if options.with_fleet else frozenset()
        self.bridge = Bridge(scenario, uav_id, link, ports, options.allow_arming, awaited)
        self._near = NearPublisher(self.endpoints, scenario, uav_id, edges)
        self._send_status = self.endpoints.publisher(topics.DIAGNOSTICS, recorders)
        self._status_log = StatusLog(node)
        self.endpoints.last_word = self._publish_status
        self._reports = FleetReports(self.endpoints, scenario, uav_id, ports)
        self._subscribe(scenario, uav_id)
        desk = partial(OrderDesk, self.bridge, scenario, uav_id, options.signing_key)
        try:
            self.orders = desk(runtime_folder(named_domain(), self.endpoints.fleet))
        except RuntimeFolderError as error:
            ports.log(f"warning: no local path for ptnsbc stop: {error}")
            self.orders = desk(None)
        self.endpoints.listen(topics.EMERGENCY, decode_order, self.orders.on_order, required=False)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._status_timer = node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        self._battery = self.bridge.vehicle.battery.newest
        self._leaving = False
        self._thread = threading.Thread(target=self._run, name=f"bridge{uav_id}", daemon=True)

    @property
    def exit_code(self) -> int:
        """0 after a flight as planned, or without any."""
        procedure = self.bridge.procedure
        unfinished = self.bridge.flew and procedure.step is not Step.DONE
        return int(bool(procedure.fault) or unfinished)

    def start(self) -> None:
        """Begin communication with the vehicle."""
        self._thread.start()

    def land(self) -> bool:
        """Request a landing; returns whether the vehicle is armed and this bridge flies it."""
        procedure = self.bridge.procedure
        if procedure.step in _NOT_OURS or procedure.in_pilots_hands:
            return False
        self.bridge.ports.inputs.take(Order(LAND))
        return self.bridge.vehicle.armed

    def close(self) -> None:
        """Stop the thread, and the stream with it; close the link and the port for orders."""
        self._leaving = True
        self._thread.join(timeout=2.0)
        self.orders.close()
        self.bridge.link.close()

    def waiting_for(self) -> list[str]:
        """The things for which the formation waits; empty when it may begin."""
        missing = self.endpoints.unheard()
        if not self.bridge.flew:
            missing += self.endpoints.contested()
        if self.bridge.procedure.awaited:
            missing.append(self.bridge.procedure.awaited)
        return missing

    def _subscribe(self, scenario: Scenario, uav_id: int) -> None:
        listen, inputs = self.endpoints.listen, self.bridge.ports.inputs
        attitude = scenario.vehicle_link(uav_id).setpoint == "attitude"
        setpoint = topics.wrench_setpoint if attitude else topics.velocity_setpoint
        decode = as_bytes(checked_wrench if attitude else checked_velocity)
        listen(setpoint(uav_id), decode, partial(setattr, inputs, "setpoint"))
        if attitude:  # a wrench does not tell where the planner wants the vehicle to go
            wanted = topics.velocity_setpoint(uav_id)
            listen(wanted, checked_velocity, partial(setattr, inputs, "wanted"), required=False)
        listen(topics.EPOCH, decode_leg, inputs.legs.append)
        if scenario.formation.reconfigures:  # a successor of the leader announces the legs as well
            self.endpoints.shared.add(topics.EPOCH.name)
        if scenario.takes_setpoints:
            decode_taken = OdometryDecoder(WORLD_FRAME, WORLD_FRAME)
            listen(topics.TAKEN, decode_taken, inputs.taken.append, required=False)
        if self.bridge.state_publisher.world.needs_leader:
            hear = partial(setattr, inputs, "leader_origin")
            listen(topics.ORIGIN, vehicle_messages.decode_origin, hear, required=False)

    def _on_status_timer(self) -> None:
        procedure = self.bridge.procedure
        if not procedure.awaited:
            self._reports.close()
        if procedure.step is Step.APART:
            self._ports.apart()  # again, for a bridge that has just met this one
        battery = self.bridge.vehicle.battery.newest
        new = battery is not self._battery  # the vehicle has reported it since
        if new and any(figure is not None for figure in battery):
            self._battery = battery
            self._ports.battery(battery)
        self._publish_status()

    def _publish_status(self) -> None:
        record, missing = self.orders.keep(), self.waiting_for()
        self._send_status(
            bridge_status(
                self._name, record, self.bridge, missing, self.endpoints, self._status_log
            )
        )

    def _run(self) -> None:
        bridge = self.bridge
        try:
            while not self._leaving and not bridge.procedure.over:
                bridge.wait_and_serve()
                self._near.publish_due(bridge)
            bridge.leave()
        except Exception as error:  # the thread must not die in silence and leave a stream behind
            bridge.procedure.fail(f"bridge failed: {error!r}")
            raise
        finally:
            if not self._leaving:
                self._on_end(bridge.procedure.fault or bridge.procedure.step.value)
