"""The bridge on ROS 2: topics in and out around `Bridge`, which runs in a thread of its own.

The thread of the node only stores messages as inputs of the bridge. The thread of the bridge decides and sends
everything, so that a busy executor never delays the stream.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import (
    Diagnostics,
    HeaderTemplate,
    OdometryDecoder,
    OdometryTemplate,
    checked_velocity,
    checked_wrench,
    decode_diagnostics,
    encode_near,
)
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_nodes.bridge.ports import BridgeInputs, BridgeOutputs, BridgePorts, Clocks
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import SetpointLimits
from ptnsbc_nodes.bridge.status import bridge_status, companion, vehicle_record
from ptnsbc_nodes.comm import topics, vehicle_messages
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, body_frame
from ptnsbc_nodes.comm.announcements import decode_leg, decode_order
from ptnsbc_nodes.comm.diagnostics import INACTIVE, STATUS_HZ, StatusLog
from ptnsbc_nodes.comm.door import as_bytes
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.tf import LiveTransforms
from ptnsbc_nodes.comm.topics import LOST
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits
from ptnsbc_nodes.emergency.orders import (
    APART,
    LAND,
    Order,
    OrderPort,
    RuntimeFolderError,
    latch,
    latched,
    runtime_folder,
)
from ptnsbc_nodes.emergency.records import VehicleRecord, write_record
from ptnsbc_nodes.runtime.environment import named_domain
from ptnsbc_sim.scenario import Scenario

_RECORD_S = 1.0
_BRIDGE, _LINK = "bridge", ": link"
_NOT_OURS = (Step.YIELDED, Step.HEARTBEAT, Step.DONE, Step.FAILED)


class FlyingError(PtnsbcError):
    """A request to deactivate a bridge whose vehicle flies."""


class BridgeOptions(NamedTuple):
    """The options that are settled at the start of the process."""

    allow_arming: bool
    with_fleet: bool = False
    """True if every other UAV of the scenario has a bridge, which must be ready as well."""
    signing_key: str = ""
    """Path of the key file: `ptnsbc stop` reaches the vehicle with it when this process is dead."""


class BridgeNode:
    """One bridge as one rclpy node; it sends nothing to the vehicle until `activate`.

    It calls `on_end` when the flight is over.
    """

    def __init__(
        self,
        node: Node,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
        link: MavlinkLink,
        options: BridgeOptions,
        on_end: Callable[[], None],
    ) -> None:
        self.node = node
        self.endpoints = Endpoints(node, lockstep=False, seal=edges.options.seal)
        self._uav_id = uav_id
        self._on_end = on_end
        self._send_order = self.endpoints.publisher(topics.EMERGENCY, 0)
        recorders = edges.options.recorders
        clocks = Clocks(time.monotonic, lambda: int(node.get_clock().now().nanoseconds))
        ports = BridgePorts(BridgeInputs(), self._outputs(scenario, recorders), clocks)
        awaited = frozenset(scenario.uav_ids) if options.with_fleet else frozenset()
        self.bridge = Bridge(scenario, uav_id, link, ports, options.allow_arming, awaited)
        self._near = _NearPublisher(self.endpoints, scenario, uav_id, edges, clocks)
        self._send_status = self.endpoints.publisher(topics.DIAGNOSTICS, recorders)
        self.endpoints.last_word = self._publish_status
        self._diagnostics = self.endpoints.listen(
            topics.DIAGNOSTICS,
            self._decode_diagnostics,
            self._on_diagnostics,
            required=False,
            profile=keep_last(20, reliable=True),
        )
        self._subscribe(scenario)
        self._numbers = frozenset(map(str, scenario.uav_ids))
        self._record = self._new_record(scenario, options.signing_key)
        self._kept, self._kept_s = self._record, -_RECORD_S  # what the file has, and since when
        self._folder: Path | None = None
        self._status_log = StatusLog(node)
        self._send_battery = self.endpoints.publisher(topics.battery(uav_id), 0)
        self._orders = self._open_order_port()
        self._keep_record()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._status_timer = node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        self._leaving = False
        self._thread: threading.Thread | None = None

    @property
    def exit_code(self) -> int:
        """0 after a flight as planned, or without any."""
        procedure = self.bridge.procedure
        unfinished = self.bridge.flew and procedure.step is not Step.DONE
        return int(bool(procedure.fault) or unfinished)

    def activate(self) -> None:
        """Begin or resume communication with the vehicle."""
        self._leaving = False
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """Stop communication with the vehicle; refused while the bridge flies it."""
        step = self.bridge.procedure.step
        if self.bridge.vehicle.armed and step not in _NOT_OURS:
            raise FlyingError(
                f"{self._name}: {step.value}: expected a vehicle that is not "
                "flown by this bridge; land it first: /formation/land, or ptnsbc stop"
            )
        self._stop_thread()

    def land(self) -> bool:
        """Request a landing; returns whether the vehicle is armed and this bridge flies it."""
        procedure = self.bridge.procedure
        if self._thread is None or procedure.step in _NOT_OURS or procedure.in_pilots_hands:
            return False
        self._take(Order(LAND))
        return self.bridge.vehicle.armed

    def close(self) -> None:
        """Stop the thread, and the stream with it; remove everything from the node."""
        self._stop_thread()
        self._keep_record(ended=True)
        if self._orders is not None:
            self._orders.close()
        self.bridge.link.close()
        self.node.destroy_timer(self._status_timer)
        self.endpoints.close()

    @property
    def begun(self) -> bool:
        """True if the vehicle has been armed."""
        return self.bridge.flew

    def waiting_for(self) -> list[str]:
        """The things for which the formation waits; empty when it may begin."""
        missing = self.endpoints.unheard()
        if not self.begun:
            missing += self.endpoints.contested()
        if self._thread is None:
            missing.append(INACTIVE)
        if self.bridge.procedure.awaited:
            missing.append(self.bridge.procedure.awaited)
        return missing

    @property
    def _name(self) -> str:
        return f"bridge{self._uav_id}"

    @property
    def _planner(self) -> str:
        """Name of the status of the UAV process."""
        return f"uav{self._uav_id}: planner"

    def _new_record(self, scenario: Scenario, signing_key: str) -> VehicleRecord:
        """The vehicle's record with all that does not change in flight."""
        settings = scenario.vehicle_link(self._uav_id)
        return VehicleRecord(
            name=self._name,  # the folder is the fleet's own, so a namespace does not belong into it
            pid=os.getpid(),
            sysid=settings.sysid,
            autopilot=settings.autopilot,
            connect=settings.connect,
            signing_key=signing_key,
        )

    def _outputs(self, scenario: Scenario, recorders: int) -> BridgeOutputs:
        publisher = self.endpoints.publisher
        body = body_frame(self._uav_id, self.endpoints.fleet)
        odometry = OdometryTemplate(WORLD_FRAME, body)
        send_odom = publisher(topics.odom(self._uav_id), 1 + recorders)
        send_track = publisher(topics.track(self._uav_id), 0)
        send_truth = publisher(topics.truth(self._uav_id), 0)
        send_limits = publisher(topics.limits(self._uav_id), 1)
        leads = self._uav_id == scenario.leader.id
        send_origin = publisher(topics.ORIGIN, 0) if leads else None
        send_lost = publisher(LOST, 0)

        def publish_limits(limits: SetpointLimits) -> None:
            planner = PlannerLimits(limits.planner_m_s, limits.acceleration_m_s2)
            speed, acceleration = planner
            self._log(f"planner: at most {speed:g} m/s, {acceleration:g} m/s^2")
            send_limits(vehicle_messages.encode_limits(planner))

        def publish_origin(place: GeoPoint) -> None:
            if send_origin is not None:
                send_origin(vehicle_messages.encode_origin(place))

        transforms = LiveTransforms(self.endpoints, [self._uav_id])

        def publish_odometry(stamp_ns: int, values: Array) -> None:
            data = odometry.encode(stamp_ns, values)
            send_odom(data)
            transforms.publish(self._uav_id, data)

        return BridgeOutputs(
            odom=publish_odometry,
            track=lambda stamp_ns, values: send_track(odometry.encode(stamp_ns, values)),
            origin=publish_origin,
            limits=publish_limits,
            lost=lambda: send_lost(HeaderTemplate(f"uav{self._uav_id}").encode(0)),
            log=self._log,
            truth=lambda stamp_ns, values: send_truth(odometry.encode(stamp_ns, values)),
            apart=self._tell_apart,
        )

    def _subscribe(self, scenario: Scenario) -> None:
        listen, inputs = self.endpoints.listen, self.bridge.ports.inputs
        attitude = scenario.vehicle_link(self._uav_id).setpoint == "attitude"
        setpoint = topics.wrench_setpoint if attitude else topics.velocity_setpoint
        decode = as_bytes(checked_wrench if attitude else checked_velocity)
        listen(setpoint(self._uav_id), decode, lambda data: setattr(inputs, "setpoint", data))
        if attitude:  # a wrench does not tell where the planner wants the vehicle to go
            wanted = topics.velocity_setpoint(self._uav_id)
            listen(
                wanted, checked_velocity, lambda one: setattr(inputs, "wanted", one), required=False
            )
        listen(topics.EPOCH, decode_leg, inputs.legs.append)
        if scenario.formation.reconfigures:  # a successor of the leader announces the legs as well
            self.endpoints.shared.add(topics.EPOCH.name)
        if scenario.takes_setpoints:
            decode_taken = OdometryDecoder(WORLD_FRAME, WORLD_FRAME)
            listen(topics.TAKEN, decode_taken, inputs.taken.append, required=False)
        listen(topics.EMERGENCY, decode_order, self._on_order, required=False)
        if self.bridge.state_publisher.world.needs_leader:
            listen(topics.ORIGIN, vehicle_messages.decode_origin, self._on_origin, required=False)

    def _on_origin(self, place: GeoPoint) -> None:
        self.bridge.ports.inputs.leader_origin = place

    def _on_order(self, order: Order) -> None:
        """An order of the operator; it is latched, so that this bridge obeys it also after a restart."""
        if self._take(order):
            self._log(f"emergency: {order.text}")
            if self._folder is not None and order.what != APART:
                with suppress(OSError):
                    latch(self._folder, order)

    def _take(self, order: Order) -> bool:
        return self.bridge.ports.inputs.take(order)

    def _open_order_port(self) -> OrderPort | None:
        """The socket for orders of this host, and the order that still holds from before."""
        try:
            domain = named_domain()
            self._folder = runtime_folder(domain, self.endpoints.fleet)
            port = OrderPort(
                self._folder, self._record.name, self._on_order, lambda: self._present().encode()
            )
        except RuntimeFolderError as error:
            self._log(f"warning: no local path for ptnsbc stop: {error}")
            return None
        held = latched(self._folder)
        if held.what:
            self.bridge.procedure.fail(
                f"the operator's order {held.text!r} still holds: ptnsbc stop --clear releases it"
            )
            self._take(held)
        return port

    def _present(self) -> VehicleRecord:
        return vehicle_record(self._record.name, self.bridge, self._record)

    def _keep_record(self, *, ended: bool = False) -> VehicleRecord:
        """The vehicle's record of now; in its file it is at most a second old, and a change is there at once."""
        record, now_s = replace(self._present(), ended=ended), time.monotonic()
        changed = replace(record, place=self._kept.place) != self._kept
        if self._folder is not None and (changed or now_s >= self._kept_s + _RECORD_S):
            self._kept, self._kept_s = record, now_s
            with suppress(OSError):
                write_record(self._folder, record)
        return record

    def _decode_diagnostics(self, data: bytes) -> Diagnostics | None:
        """The statuses of the UAV process and of bridges; None for others, which are not worth decoding."""
        wanted = self._planner.encode() in data or _LINK.encode() in data
        return decode_diagnostics(data) if wanted else None

    def _on_diagnostics(self, array: Diagnostics | None) -> None:
        """Before arming: whether the UAV process has everything it needs."""
        for status in array.statuses if array is not None else ():
            if status.name == self._planner:
                ports, values = self.bridge.ports, status.values
                ports.inputs.controller_ready = values.get("ready") == "true"
                if INACTIVE in values.get("waiting_for", "").split():
                    ports.inputs.controller_held_s = ports.clocks.steady_s()
            elif status.name.startswith(_BRIDGE) and status.name.endswith(_LINK):
                number = status.name.removeprefix(_BRIDGE).removesuffix(_LINK)
                self._on_companion(number, status.values)

    def _on_companion(self, number: str, values: Mapping[str, str]) -> None:
        """The status of the bridge of another vehicle of the fleet."""
        report = companion(values)
        if report is not None and number in self._numbers:
            inputs, now_s = self.bridge.ports.inputs, self.bridge.ports.clocks.steady_s()
            inputs.companions.append((int(number), report, now_s))

    def _on_status_timer(self) -> None:
        if self.bridge.procedure.ready:
            # In flight nothing reads the diagnostics of others, so they are not worth their reception.
            self._unsubscribe_diagnostics()
        if self.bridge.procedure.step is Step.APART:
            self._tell_apart()  # again, for a bridge that has just met this one
        battery = self.bridge.vehicle.battery.newest
        if battery is not None:
            stamp_ns = self.bridge.ports.clocks.ros_ns()
            self._send_battery(vehicle_messages.encode_battery(stamp_ns, *battery))
        self._publish_status()

    def _publish_status(self) -> None:
        record = self._keep_record()
        missing = self.waiting_for()
        self._send_status(
            bridge_status(
                self._name, record, self.bridge, missing, self.endpoints, self._status_log
            )
        )

    def _tell_apart(self) -> None:
        """All others give the formation up as well."""
        self._send_order(HeaderTemplate(APART).encode(0))

    def _unsubscribe_diagnostics(self) -> None:
        self.endpoints.ignore(self._diagnostics)

    def _stop_thread(self) -> None:
        self._leaving = True
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None

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
                self._on_end()

    def _log(self, line: str) -> None:
        print(f"{self._name}: {line}", file=sys.stderr, flush=True)


class _NearPublisher:
    """Publishes the near objects of one UAV, from the scenario and from the odometry of other UAVs.

    It hears all of them, because its bridge gives the formation up for any that comes too near, and lands above any.
    """

    def __init__(
        self,
        endpoints: Endpoints,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
        clocks: Clocks,
    ) -> None:
        self._objects = NearObjects(scenario, uav_id, edges.linked(uav_id))
        self._clocks = clocks
        self._period_s = 1.0 / scenario.sensor.rate_hz
        self._next_s = 0.0
        self._send = endpoints.publisher(topics.near(uav_id), 1 + edges.options.recorders)
        for other in sorted(set(scenario.uav_ids) - {uav_id}):
            for topic in (topics.odom(other), topics.track(other)):
                decode = as_bytes(OdometryDecoder())
                endpoints.listen(topic, decode, self._on_odometry(other), required=False)

    def _on_odometry(self, uav_id: int) -> Callable[[bytes], None]:
        return lambda data: self._objects.on_odometry(uav_id, self._clocks.steady_s(), data)

    def publish_due(self, bridge: Bridge) -> None:
        """Publish at the rate of the scenario's sensor, once the bridge knows its own odometry."""
        now_s, odometry = self._clocks.steady_s(), bridge.state_publisher.odometry
        if odometry is None or now_s < self._next_s:
            return
        self._next_s = now_s + self._period_s
        bridge.ports.inputs.near_uavs = self._objects.uavs(now_s)
        rows = self._objects.rows(now_s, odometry[0:3], bridge.flight_s())
        self._send(encode_near(self._clocks.ros_ns(), WORLD_FRAME, rows))
