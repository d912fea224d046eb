"""A UAV without laws."""

from __future__ import annotations

from functools import partial

import numpy as np
from rclpy.node import Node

from bench.pingpong.endpoints import RawEndpoints, Send, status, when_ready
from ptnsbc_io.wire import OdometryTemplate, VelocityTemplate, WrenchTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.runtime.pacing import Pace, Ticker
from ptnsbc_sim.scenario import Scenario


class BareUav:
    """Answers like a UAV: four messages when odometry, near objects and neighbours are in."""

    def __init__(
        self,
        node: Node,
        endpoints: RawEndpoints,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
    ) -> None:
        self._endpoints = endpoints
        self.ticks = 0
        self.pace = Pace(scenario.dt_ns)
        self._node = node
        self._scenario = scenario
        self._lockstep = edges.options.lockstep
        self._period_ns = scenario.dt_ns
        self._near_ns = scenario.dt_ns * scenario.near_every
        self._own_ns = self._seen_ns = self._done_ns = -1
        self._listen(uav_id, edges)
        self._sends = self._senders(uav_id, edges)
        self._ticker = None
        if not self._lockstep:
            self._ticker = Ticker(node, self._period_ns, self._on_timer)
        when_ready(node, endpoints, None, lambda: None)

    def _listen(self, uav_id: int, edges: CommunicationGraph) -> None:
        senders = edges.senders(uav_id)
        received = [topics.formation_state(i) for i in senders.states]
        received += [topics.leader_estimate(i) for i in senders.estimators]
        self._received_ns = [-1] * len(received)
        self._endpoints.listen_stamps(topics.odom(uav_id), self._on_odom)
        self._endpoints.listen_stamps(topics.near(uav_id), self._on_near)
        for index, topic in enumerate(received):
            self._endpoints.listen_stamps(topic, partial(self._on_message, index))

    def _senders(self, uav_id: int, edges: CommunicationGraph) -> tuple[Send, ...]:
        body, zeros = f"uav{uav_id}/base_link", np.zeros(13)
        state = OdometryTemplate(WORLD_FRAME, body).encode(0, zeros)
        estimate = OdometryTemplate(WORLD_FRAME, WORLD_FRAME).encode(0, zeros)
        velocity = VelocityTemplate(WORLD_FRAME).encode(0, zeros[:6])
        wrench = WrenchTemplate(body).encode(0, zeros[:6])
        sender, readers = self._endpoints.sender, edges.options.recorders
        self._status_every = status_every(self._scenario)
        self._send_status = sender(topics.DIAGNOSTICS, readers, status(f"uav{uav_id}"))
        # The order of the Outbox: the wrench first.
        return (
            sender(topics.wrench_setpoint(uav_id), 1 + readers, wrench),
            sender(topics.formation_state(uav_id), edges.state_readers(uav_id), state),
            sender(topics.leader_estimate(uav_id), edges.estimate_readers(uav_id), estimate),
            sender(topics.velocity_setpoint(uav_id), readers, velocity),
        )

    def _on_message(self, index: int, stamp_ns: int) -> None:
        self._received_ns[index] = stamp_ns
        self._advance()

    def _on_odom(self, stamp_ns: int) -> None:
        first = self._own_ns < 0
        self._own_ns = stamp_ns
        if first and self._ticker is not None:
            self._ticker.align(self._own_ns)
        self._advance()

    def _on_near(self, stamp_ns: int) -> None:
        self._seen_ns = stamp_ns
        self._advance()

    def _advance(self) -> None:
        now_ns = self._own_ns
        if not self._lockstep or now_ns <= self._done_ns:
            return
        if self._seen_ns != now_ns - now_ns % self._near_ns:
            return
        before_ns = now_ns - self._period_ns
        if now_ns == 0 or all(stamp_ns >= before_ns for stamp_ns in self._received_ns):
            self._answer(now_ns)

    def _on_timer(self) -> None:
        self.pace.tick(int(self._node.get_clock().now().nanoseconds))
        if self._own_ns < 0:
            self.pace.missed = 0
        else:
            self._answer(self._own_ns)

    def _answer(self, stamp_ns: int) -> None:
        self._done_ns = stamp_ns
        self.ticks += 1
        for send in self._sends:
            send(stamp_ns)
        if self.ticks % self._status_every == 0:
            self._send_status(stamp_ns)
