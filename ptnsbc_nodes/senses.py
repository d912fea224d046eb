"""What the simulated world tells: odometry, near objects, time, and pictures of it all."""

from __future__ import annotations

from importlib import import_module

from ptnsbc_nodes import topics
from ptnsbc_nodes.edges import FlightOptions
from ptnsbc_nodes.endpoints import Endpoints
from ptnsbc_nodes.letters import WORLD_FRAME
from ptnsbc_nodes.markers import Scene
from ptnsbc_nodes.plain import encode
from ptnsbc_nodes.status import STATUS_HZ
from ptnsbc_nodes.wire import ClockTemplate, OdometryTemplate, encode_near
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class Senses:
    """Publishers of the sim; one call per tick."""

    def __init__(
        self, endpoints: Endpoints, scenario: Scenario, world: World, options: FlightOptions
    ) -> None:
        self._world = world
        self._near_every = scenario.near_every
        self._scene_every = max(scenario.control_hz // STATUS_HZ, 1)
        self._calls = 0
        self._scene = Scene(scenario, world)
        self._clock = ClockTemplate()
        ids, readers = world.ids, options.recorders
        self._odometry = {i: OdometryTemplate(WORLD_FRAME, f"uav{i}/base_link") for i in ids}
        self._send_odom = {i: endpoints.publisher(topics.odom(i), 1 + readers) for i in ids}
        self._send_near = {i: endpoints.publisher(topics.near(i), 1 + readers) for i in ids}
        self._send_clock = endpoints.publisher(topics.CLOCK, readers)
        self._send_markers = endpoints.publisher(topics.MARKERS, readers)
        # For viewers only: the recorder makes its own.
        self._send_tf = endpoints.publisher(topics.TF, 0) if topics.tf_is_available() else None

    def publish(self, stamp_ns: int) -> None:
        """Tell the world's state of now; near objects and pictures at their own rates."""
        world = self._world
        for i in world.ids:
            self._send_odom[i](self._odometry[i].encode(stamp_ns, world.odometry(i)))
        if self._calls % self._near_every == 0:
            for i in world.ids:
                self._send_near[i](encode_near(stamp_ns, WORLD_FRAME, world.near(i)))
        self._send_clock(self._clock.encode(stamp_ns))
        if self._calls % self._scene_every == 0:
            self._picture(stamp_ns)
        self._calls += 1

    def _picture(self, stamp_ns: int) -> None:
        self._send_markers(self._scene.markers(stamp_ns))
        if self._send_tf is not None:
            transforms = self._scene.transforms(stamp_ns)
            message = import_module("tf2_msgs.msg").TFMessage(transforms=transforms)
            self._send_tf(encode(message))
