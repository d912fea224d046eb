"""The messages that one UAV publishes at each tick."""

from __future__ import annotations

from ptnsbc_core.agent import PackedOutputs
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import AgentMessages
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.uav.controller import StepTime, UavController
from ptnsbc_nodes.uav.faults import UavFaults
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.step_log import SnapshotTemplate, TickTemplate, used_by


class Outbox:
    """Publishers of one UAV."""

    def __init__(
        self, endpoints: Endpoints, edges: CommunicationGraph, uav_id: int, faults: UavFaults
    ) -> None:
        sent = faults.sent if faults.allowed else None
        self._messages = AgentMessages(uav_id, endpoints.fleet, sent)
        publisher = endpoints.publisher
        self._send_wrench = publisher(topics.wrench_setpoint(uav_id), edges.wrench_readers())
        self._send_state = publisher(topics.formation_state(uav_id), edges.state_readers(uav_id))
        self._send_estimate = publisher(
            topics.leader_estimate(uav_id), edges.estimate_readers(uav_id)
        )
        self._send_velocity = publisher(topics.velocity_setpoint(uav_id), edges.options.recorders)
        self._step_log: _StepLogPublisher | None = None

    def log_steps(
        self, endpoints: Endpoints, edges: CommunicationGraph, uav_id: int, every: int
    ) -> None:
        """Publish the step log from now on, with a snapshot every so many steps."""
        self._step_log = _StepLogPublisher(endpoints, edges, uav_id, every)

    def send(
        self, own: Stamped, outputs: PackedOutputs, at: StepTime, controller: UavController
    ) -> None:
        """Publish the tick computed from `own`; the wrench first, because the plant waits for it."""
        messages, stamp_ns = self._messages, own.stamp_ns
        self._send_wrench(messages.wrench(stamp_ns, outputs.wrench))
        self._send_state(messages.state(own, outputs))
        self._send_estimate(messages.estimate(stamp_ns, outputs.leader_estimate))
        self._send_velocity(messages.velocity(stamp_ns, outputs.velocity))
        if self._step_log is not None:
            self._step_log.send(at, controller)


class _StepLogPublisher:
    """Publishers of the step log, with which the steps of a UAV in real time can be repeated."""

    def __init__(
        self, endpoints: Endpoints, edges: CommunicationGraph, uav_id: int, every: int
    ) -> None:
        readers = edges.options.recorders
        self._every = every  # steps from one snapshot to the next
        self._senders = edges.senders(uav_id)
        self._template = TickTemplate(self._senders)
        self._send_tick = endpoints.publisher(topics.tick(uav_id), readers)
        self._send_snapshot = endpoints.publisher(topics.snapshot(uav_id), readers)
        self._snapshot: SnapshotTemplate | None = None

    def send(self, at: StepTime, controller: UavController) -> None:
        """Publish the messages that the step `at` used, and at times the state after it."""
        sequence = controller.steps - 1
        if controller.inbox.senders is not self._senders:  # it has taken another slot
            self._senders = controller.inbox.senders
            self._template = TickTemplate(self._senders)
        used = used_by(controller, at.now_ns, NO_CUTOFF_NS)
        self._send_tick(self._template.encode(sequence, at, used))
        if sequence % self._every == 0:
            self._snapshot = self._snapshot or SnapshotTemplate(controller)
            self._send_snapshot(self._snapshot.encode(sequence, controller))
