"""The publishers of the simulated world: odometry, near objects, time, markers and transforms."""

from __future__ import annotations

from ptnsbc_io.wire import ClockTemplate, OdometryTemplate, encode_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, body_frame
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.markers import Scene
from ptnsbc_nodes.comm.tf import LiveTransforms
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class SimPublishers:
    """Publishers of the sim: all at once in real time, one vehicle at a time in lock-step."""

    def __init__(
        self, endpoints: Endpoints, scenario: Scenario, world: World, edges: CommunicationGraph
    ) -> None:
        self._world = world
        self._near_every = scenario.near_every
        self._scene_every = status_every(scenario)
        self._calls = 0
        self._scene = Scene(scenario, world)
        self._clock_template = ClockTemplate()
        ids, recorders = world.ids, edges.options.recorders
        self._odometry_templates = {
            i: OdometryTemplate(WORLD_FRAME, body_frame(i, endpoints.fleet)) for i in ids
        }
        self._send_odom = {
            i: endpoints.publisher(topics.odom(i), edges.odometry_readers(i)) for i in ids
        }
        self._send_truth = (
            {i: endpoints.publisher(topics.truth(i), recorders) for i in ids}
            if scenario.imperfect
            else {}
        )
        self._send_near = {i: endpoints.publisher(topics.near(i), 1 + recorders) for i in ids}
        self._send_clock = endpoints.publisher(topics.CLOCK, recorders)
        self._send_markers = endpoints.publisher(topics.MARKERS, recorders)
        self._tf = LiveTransforms(endpoints, ids)

    def publish(self, stamp_ns: int) -> None:
        """Publish the world's state; near objects and markers at their own rates."""
        for i in self._world.ids:
            self.vehicle(i, self._calls, stamp_ns)
        self.clock(stamp_ns)
        if self._calls % self._scene_every == 0:
            self.markers(stamp_ns)
        self._calls += 1

    def vehicle(self, uav_id: int, tick: int, stamp_ns: int) -> None:
        """Publish the odometry of one UAV, and at the rate of its sensor the near objects."""
        state = self._world.odometry(uav_id)
        odometry = self._odometry_templates[uav_id].encode(stamp_ns, state)
        self._send_odom[uav_id](odometry)
        self._tf.publish(uav_id, odometry)
        if uav_id in self._send_truth:
            truth = self._world.truth(uav_id)
            self._send_truth[uav_id](self._odometry_templates[uav_id].encode(stamp_ns, truth))
        if tick % self._near_every == 0:
            near = self._world.near(uav_id)
            self._send_near[uav_id](encode_near(stamp_ns, WORLD_FRAME, near))

    def clock(self, stamp_ns: int) -> None:
        """Publish the time."""
        self._send_clock(self._clock_template.encode(stamp_ns))

    def markers(self, stamp_ns: int) -> None:
        """Publish markers for viewers."""
        self._send_markers(self._scene.markers(stamp_ns))
