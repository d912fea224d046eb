"""A fleet of vehicles behind a RosLink in place of MAVLink, on the clock of the tests."""

import numpy as np
from mavlink_fleet import STEP_S, FleetUav, MavlinkFleet

from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.link import RosLink

LAG_S, POSE_S = 0.15, 0.02
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class PointMass:
    """What flies: it takes velocities with a lag, and climbs or descends to a target."""

    def __init__(self, position, height_m):
        self.position, self.velocity, self.wanted = np.array(position), np.zeros(3), np.zeros(3)
        self.height_m, self.target_m = height_m, None
        self.requests, self.setpoints = [], 0
        self.told, self.refuses = True, ()  # a test changes it
        self.next_s = 0.0

    def step(self, link, now_s):
        wanted = self.wanted
        if self.target_m is not None:
            wanted = np.array([0.0, 0.0, np.clip(self.target_m - self.position[2], -0.7, 0.7)])
        if link.armed:
            self.velocity = self.velocity + STEP_S / LAG_S * (wanted - self.velocity)
            self.position = self.position + STEP_S * self.velocity
            self.position[2] = max(self.position[2], 0.0)
        if self.told and now_s >= self.next_s:
            self.next_s = now_s + POSE_S
            link.pose(0, self.position.copy(), LEVEL)


class PointMassLink(RosLink):
    """The link to one: it takes velocities, and positions while it is to hold one."""

    def __init__(self, mass, steady_s):
        super().__init__(steady_s)
        self.mass = mass

    def fly(self, position, velocity, acceleration, yaw):
        mass = self.mass
        mass.setpoints += 1
        mass.wanted = position - mass.position if velocity is None else velocity
        mass.target_m = None if mass.target_m == mass.height_m else mass.target_m

    def request(self, request):
        self.mass.requests.append(request)
        if request in self.mass.refuses:
            return self.say(f"{request.value}: not today")
        if request is CommandRequest.TAKEOFF:
            self.mass.target_m = self.mass.height_m
        if request is CommandRequest.LAND:
            self.mass.target_m = 0.0
        if request is CommandRequest.DISARM and not self.down:
            return None
        return self.done(request)


class RosUav(FleetUav):
    """One of its UAVs."""

    mass = None

    def begin_bridge(self, frame=""):
        self.inputs.companions.clear()
        self.inputs.legs += [HeaderFields(*leg) for leg in self.fleet.legs]  # they are latched
        scenario = self.fleet.scenario
        if self.mass is None:
            start = (*scenario.uav(self.id).position_m[:2], 0.0)
            self.mass = PointMass(start, scenario.mavlink.takeoff_height_m)
        self.link = PointMassLink(self.mass, self.fleet.now)
        self.bridge = Bridge(scenario, self.id, self.link, self.ports, True, self.fleet.awaited)
        self.bridge.take_over(frame)
        self.bridge_alive = True

    def exchange(self):
        self.mass.step(self.link, self.fleet.now_s)
        if self.bridge_alive and not self.bridge.procedure.over:
            self.bridge.serve()


class RosFleet(MavlinkFleet):
    """All vehicles of a scenario."""

    KIND = RosUav
