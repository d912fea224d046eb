"""The bridge on ROS 2: topics in and out around `Bridge`, which runs in a thread of its own.

The thread of the node only puts what it hears where the bridge finds it; all decisions and all
sending happen in the other one, so that a busy executor never holds the stream up.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import HeaderTemplate, OdometryTemplate, decode_header, encode_near
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_nodes.bridge.ports import BridgeOutputs
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.report import report
from ptnsbc_nodes.bridge.setpoint.guard import SetpointLimits
from ptnsbc_nodes.bridge.state_publisher import Clocks
from ptnsbc_nodes.comm import topics, vehicle_messages
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.diagnostics import INACTIVE, STATUS_HZ
from ptnsbc_nodes.comm.endpoints import LOST, Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits
from ptnsbc_sim.scenario import Scenario

_STOPS = ("land", "kill")
_NOT_OURS = (Step.YIELDED, Step.HEARTBEAT, Step.DONE, Step.FAILED)


class FlyingError(PtnsbcError):
    """A bridge that was asked to leave its vehicle alone in the air."""


class BridgeNode:
    """One bridge as one rclpy node; silent towards the vehicle until `activate`.

    It calls `on_end` when the flight is over.
    """

    def __init__(
        self,
        node: Node,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
        link: MavlinkLink,
        allow_arming: bool,
        on_end: Callable[[], None],
    ) -> None:
        self.node = node
        self.endpoints = Endpoints(node, lockstep=False)
        self._name = f"bridge{uav_id}"
        self._uav = f"uav{uav_id}"
        self._on_end = on_end
        recorders = edges.options.recorders
        publisher = self.endpoints.publisher
        self._odometry = OdometryTemplate(WORLD_FRAME, f"{self._uav}/base_link")
        self._send_odom = publisher(topics.odom(uav_id), 1 + recorders)
        self._send_track = publisher(topics.track(uav_id), 0)
        self._send_near = publisher(topics.near(uav_id), 1 + recorders)
        self._send_limits = publisher(topics.limits(uav_id), 1)
        self._send_origin = publisher(topics.ORIGIN, 0)
        self._send_lost = publisher(LOST, 0)
        self._status = publisher(topics.DIAGNOSTICS, recorders)
        clocks = Clocks(time.monotonic, lambda: int(node.get_clock().now().nanoseconds))
        self._clocks = clocks
        outlets = BridgeOutputs(
            odom=self._tell,
            track=lambda stamp, odom: self._send_track(self._odometry.encode(stamp, odom)),
            origin=lambda place: self._send_origin(vehicle_messages.encode_origin(place)),
            limits=self._tell_limits,
            lost=lambda: self._send_lost(HeaderTemplate(self._uav).encode(0)),
            say=self._say,
        )
        self.bridge = Bridge(scenario, uav_id, link, outlets, clocks, allow_arming)
        nearby = scenario.mavlink.near == "all"
        others = [i for i in scenario.uav_ids if i != uav_id] if nearby else edges.linked(uav_id)
        self._surroundings = NearObjects(scenario, others)
        self._near_s = 1.0 / scenario.sensor.rate_hz
        self._next_near_s = 0.0
        self._listen(scenario, uav_id)
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
        """Begin to speak to the vehicle, or go on."""
        self._leaving = False
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """Stop speaking to the vehicle; refused while it flies by our setpoints."""
        if self._flies():
            raise FlyingError(
                f"{self._name}: {self.bridge.procedure.step.value}: expected a vehicle that is not "
                "flown by this bridge; land it first: /formation/land, or ptnsbc stop"
            )
        self._silence()

    def land(self) -> bool:
        """Land and end; False when there is nothing to land, or nobody to tell."""
        if self._thread is None or self.bridge.procedure.step in _NOT_OURS:
            return False
        self.bridge.inlets.halt = self.bridge.inlets.halt or "land"
        return self.bridge.vehicle.armed

    def close(self) -> None:
        """Stop the thread, and the stream with it; take everything away from the node."""
        self._silence()
        self.bridge.link.close()
        self.node.destroy_timer(self._status_timer)
        self._destroy_ear()
        self.endpoints.close()

    def _flies(self) -> bool:
        return self.bridge.vehicle.armed and self.bridge.procedure.step not in _NOT_OURS

    def _silence(self) -> None:
        self._leaving = True
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None

    def waiting_for(self) -> list[str]:
        """Empty when the formation may begin."""
        missing = self.endpoints.unheard()
        if self._thread is None:
            missing.append(INACTIVE)
        if self.bridge.procedure.awaited:
            missing.append(self.bridge.procedure.awaited)
        return missing

    def _listen(self, scenario: Scenario, uav_id: int) -> None:
        listen, inlets = self.endpoints.listen, self.bridge.inlets
        attitude = self.bridge.setpoint == "attitude"
        wanted = topics.wrench_setpoint if attitude else topics.velocity_setpoint
        listen(wanted(uav_id), lambda data: setattr(inlets, "setpoint", data))
        listen(topics.EPOCH, self._on_epoch)
        listen(topics.EMERGENCY, self._on_emergency, required=False)
        for other in self._surroundings.others:
            for topic in (topics.odom(other), topics.track(other)):
                listen(topic, self._hearer(other), required=False)
        if self.bridge.world.needs_leader:
            listen(topics.ORIGIN, self._on_origin, required=False)
        self._ear = self.node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS.name, self._on_diagnostics, 20, raw=True
        )

    def _hearer(self, uav_id: int) -> Callable[[bytes], None]:
        return lambda data: self._surroundings.hear(uav_id, self._clocks.steady_s(), data)

    def _on_epoch(self, data: bytes) -> None:
        self.bridge.inlets.legs.append(decode_header(data))

    def _on_origin(self, data: bytes) -> None:
        self.bridge.inlets.leader_origin = vehicle_messages.decode_origin(data)

    def _on_emergency(self, data: bytes) -> None:
        what = decode_header(data).frame_id
        if what in _STOPS:
            self._say(f"emergency: {what}")
            self.bridge.inlets.halt = what

    def _on_diagnostics(self, data: bytes) -> None:
        """Before arming: whether the UAV process has everybody it needs."""
        name = f"{self._uav}: planner"
        if name.encode() not in data:
            return
        for status in deserialize_message(data, DiagnosticArray).status:
            if status.name == name:
                values = {pair.key: pair.value for pair in status.values}
                self.bridge.inlets.controller_ready = values.get("ready") == "true"

    def _on_status_timer(self) -> None:
        if self.bridge.procedure.ready:
            self._destroy_ear()  # in flight nobody reads them: not worth their reception
        now_ns = self._clocks.ros_ns()
        self._status(report(self._name, now_ns, self.bridge, self.waiting_for()))

    def _destroy_ear(self) -> None:
        if self._ear is not None:
            self.node.destroy_subscription(self._ear)
            self._ear = None

    def _run(self) -> None:
        bridge = self.bridge
        try:
            while not self._leaving and not bridge.procedure.over:
                bridge.turn()
                self._tell_near()
            bridge.leave()
        except Exception as error:  # the thread must not die in silence and leave a stream behind
            bridge.procedure.fail(f"bridge failed: {error!r}")
            raise
        finally:
            if not self._leaving:
                self._on_end()

    def _tell(self, stamp_ns: int, odometry: Array) -> None:
        self._send_odom(self._odometry.encode(stamp_ns, odometry))

    def _tell_limits(self, limits: SetpointLimits) -> None:
        told = PlannerLimits(limits.planner_m_s, limits.acceleration_m_s2)
        self._say(f"planner: at most {told.speed_m_s:g} m/s, {told.acceleration_m_s2:g} m/s^2")
        self._send_limits(vehicle_messages.encode_limits(told))

    def _tell_near(self) -> None:
        now_s, odometry = self._clocks.steady_s(), self.bridge.teller.odometry
        if odometry is None or now_s < self._next_near_s:
            return
        self._next_near_s = now_s + self._near_s
        rows = self._surroundings.rows(now_s, odometry[0:3])
        self._send_near(encode_near(self._clocks.ros_ns(), WORLD_FRAME, rows))

    def _say(self, line: Any) -> None:
        print(f"{self._name}: {line}", file=sys.stderr, flush=True)
