"""What one UAV sends at each tick."""

from __future__ import annotations

from ptnsbc_core.agent import PackedOutputs
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import AgentMessages
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.uav.controller import StepTime, UavController
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.step_log import SnapshotTemplate, TickTemplate


class Outbox:
    """Publishers of one UAV."""

    def __init__(self, endpoints: Endpoints, edges: CommunicationGraph, uav_id: int) -> None:
        self._letters = AgentMessages(uav_id)
        publisher = endpoints.publisher
        self._send_wrench = publisher(topics.wrench_setpoint(uav_id), edges.wrench_readers())
        self._send_state = publisher(topics.formation_state(uav_id), edges.state_readers(uav_id))
        self._send_estimate = publisher(
            topics.leader_estimate(uav_id), edges.estimate_readers(uav_id)
        )
        self._send_velocity = publisher(topics.velocity_setpoint(uav_id), edges.options.recorders)

    def send(self, own: Stamped, outputs: PackedOutputs) -> None:
        """Publish the tick computed from `own`; the wrench first, the plant waits for it."""
        letters, stamp_ns = self._letters, own.stamp_ns
        self._send_wrench(letters.wrench(stamp_ns, outputs.wrench))
        self._send_state(letters.state(own))
        self._send_estimate(letters.estimate(stamp_ns, outputs.leader_estimate))
        self._send_velocity(letters.velocity(stamp_ns, outputs.velocity))


class StepLogPublisher:
    """Publishers of what makes the steps of one UAV in real time repeatable (`ticklog`)."""

    def __init__(
        self, endpoints: Endpoints, edges: CommunicationGraph, uav_id: int, every: int
    ) -> None:
        readers = edges.options.recorders
        self._every = every  # steps from one snapshot to the next
        self._template = TickTemplate(edges.senders(uav_id))
        self._send_tick = endpoints.publisher(topics.tick(uav_id), readers)
        self._send_snapshot = endpoints.publisher(topics.snapshot(uav_id), readers)
        self._snapshot: SnapshotTemplate | None = None

    def send(self, at: StepTime, pilot: UavController) -> None:
        """Publish what the step `at` was made of, and now and then what it left behind."""
        sequence = pilot.steps - 1
        held = pilot.inbox.held(NO_CUTOFF_NS)
        self._send_tick(self._template.encode(sequence, at, held))
        if sequence % self._every == 0:
            self._snapshot = self._snapshot or SnapshotTemplate(pilot)
            self._send_snapshot(self._snapshot.encode(sequence, pilot))
