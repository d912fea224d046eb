"""What one UAV sends at each tick, as patched byte templates."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.types import AgentOutputs
from ptnsbc_nodes import topics
from ptnsbc_nodes.edges import Edges
from ptnsbc_nodes.endpoints import Endpoints
from ptnsbc_nodes.wire import OdometryTemplate, Stamped, VelocityTemplate, WrenchTemplate

WORLD_FRAME = "map"


class Outbox:
    """Publishers of one UAV; messages carry the stamp of the odometry they were computed from."""

    def __init__(self, endpoints: Endpoints, edges: Edges, uav_id: int) -> None:
        body = f"uav{uav_id}/base_link"
        self._state = OdometryTemplate(WORLD_FRAME, body)
        # Velocities of an estimate are in the world frame, not in the body of whoever sends it.
        self._estimate = OdometryTemplate(WORLD_FRAME, WORLD_FRAME)
        self._velocity = VelocityTemplate(WORLD_FRAME)
        self._wrench = WrenchTemplate(body)
        self._twist = np.zeros(6)
        publisher = endpoints.publisher
        self._send_wrench = publisher(topics.wrench_setpoint(uav_id), edges.wrench_readers())
        self._send_state = publisher(topics.formation_state(uav_id), edges.state_readers(uav_id))
        self._send_estimate = publisher(
            topics.leader_estimate(uav_id), edges.estimate_readers(uav_id)
        )
        self._send_velocity = publisher(topics.velocity_setpoint(uav_id), edges.options.recorders)

    def send(self, own: Stamped, outputs: AgentOutputs) -> None:
        """Publish the tick computed from `own`; the wrench first, the plant waits for it."""
        stamp_ns = own.stamp_ns
        self._twist[0:3] = outputs.velocity[0:3]
        self._twist[5] = outputs.velocity[3]
        self._send_wrench(self._wrench.encode(stamp_ns, outputs.wrench))
        self._send_state(self._state.encode(stamp_ns, own.values))
        self._send_estimate(self._estimate.encode(stamp_ns, outputs.leader_estimate))
        self._send_velocity(self._velocity.encode(stamp_ns, self._twist))
