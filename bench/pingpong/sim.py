"""A simulator without a world, and a recorder without a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from rclpy.node import Node

from bench.pingpong.endpoints import RawEndpoints, Send, status, when_ready
from ptnsbc_io.wire import ClockTemplate, OdometryTemplate, encode_near
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.markers import Scene
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_nodes.runtime.pacing import Latency, Pace
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World

_NEAR_OBJECTS = 2


class BareSim:
    """Ticks like the sim: by the barrier of all wrenches, or by a timer."""

    def __init__(
        self,
        node: Node,
        endpoints: RawEndpoints,
        scenario: Scenario,
        edges: CommunicationGraph,
        go: Path,
        on_end: Callable[[], None],
    ) -> None:
        self._endpoints = endpoints
        self.ticks = 0
        self.pace = Pace(scenario.dt_ns)
        self.latency = Latency()
        self.began_ns = self.ended_ns = 0
        self._node = node
        self._scenario = scenario
        self._lockstep = edges.options.lockstep
        self._on_end = on_end
        self._answers = 0
        self._now_ns = -1
        readers = edges.options.recorders
        near = np.ones((_NEAR_OBJECTS, 7))
        self._odom = self._senders(
            topics.odom,
            readers,
            lambda i: OdometryTemplate(WORLD_FRAME, f"uav{i}/base_link").encode(0, np.zeros(13)),
        )
        self._near = self._senders(
            topics.near, readers, lambda i: encode_near(0, WORLD_FRAME, near)
        )
        self._clock = endpoints.sender(topics.CLOCK, readers, ClockTemplate().encode(0))
        self._send_status = endpoints.sender(topics.DIAGNOSTICS, readers, status("sim"))
        self._send_markers = endpoints.publisher(topics.MARKERS, readers)
        self._markers = Scene(scenario, World(scenario)).markers(0)
        for i in scenario.uav_ids:
            endpoints.listen_stamps(topics.wrench_setpoint(i), self._on_wrench)
        when_ready(node, endpoints, go, self._begin)

    def _senders(
        self, topic: Callable[[int], Topic], readers: int, message: Callable[[int], bytes]
    ) -> list[Send]:
        send = self._endpoints.sender
        return [send(topic(i), 1 + readers, message(i)) for i in self._scenario.uav_ids]

    def _begin(self) -> None:
        self.began_ns = self._clock_ns()
        if self._lockstep:
            self._publish(0)
        else:
            self._node.create_timer(self._scenario.dt_ns * 1e-9, self._on_timer)

    def _clock_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _on_timer(self) -> None:
        now_ns = self._clock_ns()
        self.pace.tick(now_ns)
        if now_ns - self.began_ns > self._scenario.duration_s * 1e9:
            self._end()
        else:
            self.ticks += 1
            self._publish(now_ns)

    def _publish(self, stamp_ns: int) -> None:
        self._now_ns = stamp_ns
        number = self.ticks
        for send in self._odom:
            send(stamp_ns)
        if number % self._scenario.near_every == 0:
            for send in self._near:
                send(stamp_ns)
        self._clock(stamp_ns)
        if number % status_every(self._scenario) == 0:
            self._send_markers(self._markers)
            self._send_status(stamp_ns)

    def _on_wrench(self, stamp_ns: int) -> None:
        if not self._lockstep:
            self.latency.add((self._clock_ns() - stamp_ns) * 1e-9)
            return
        self._answers += stamp_ns == self._now_ns
        if self._answers < len(self._odom):
            return
        self._answers = 0
        self.ticks += 1
        if self.ticks < self._scenario.ticks:
            self._publish(self.ticks * self._scenario.dt_ns)
        else:
            self._end()

    def _end(self) -> None:
        self.ended_ns = self._clock_ns()
        self._on_end()


class BareRecorder:
    """Subscribes to the topics of the recorder, and drops the messages."""

    def __init__(self, node: Node, scenario: Scenario, lockstep: bool) -> None:
        self.endpoints = Endpoints(node, lockstep)
        self.received = 0
        for topic in topics.recorded(scenario.uav_ids):
            profile = qos.recorder_profile(topic, lockstep=lockstep)
            kind = topics.message_class(topic)
            node.create_subscription(kind, topic.name, self._on_message, profile, raw=True)
        when_ready(node, self.endpoints, None, lambda: None)

    def _on_message(self, _data: bytes) -> None:
        self.received += 1
