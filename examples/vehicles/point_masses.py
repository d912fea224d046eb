"""Vehicles of the simplest kind, for `--backend ros`: point masses that take velocities and tell their poses.

python examples/vehicles/point_masses.py
ptnsbc fleet lab_4 --backend ros --allow-arming        # in another terminal
"""

import sys
import time
from contextlib import suppress
from functools import partial

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from std_srvs.srv import Trigger

from ptnsbc_sim.scenario import load_scenario

PERIOD_S, LAG_S, SILENT_S, CLIMB_M_S = 0.01, 0.15, 0.5, 0.7


class PointMass:
    """Takes velocities with a lag; takes off and lands by services; hovers while nobody says anything."""

    def __init__(self, node, name, position, height_m):
        self.node, self.height_m = node, height_m
        self.position, self.velocity, self.wanted = np.array(position), np.zeros(3), np.zeros(3)
        self.armed, self.target_m, self.heard_s, self.told = False, None, 0.0, True
        self.at_s = time.monotonic()
        self.poses = node.create_publisher(PoseStamped, f"/{name}/pose", 10)
        node.create_subscription(TwistStamped, f"/{name}/cmd_vel", self.on_velocity, 1)
        for service in ("arm", "take_off", "land"):
            node.create_service(Trigger, f"/{name}/{service}", partial(self.on_request, service))
        node.create_timer(PERIOD_S, self.step)

    def on_velocity(self, message):
        """A setpoint: it ends a take-off, and not a landing."""
        linear, self.heard_s = message.twist.linear, 0.0
        self.wanted = np.array([linear.x, linear.y, linear.z])
        self.target_m = None if self.target_m == self.height_m else self.target_m

    def on_request(self, service, _, response):
        """A service of it."""
        response.success = self.armed or service == "arm"
        self.armed = response.success
        self.target_m = {"take_off": self.height_m, "land": 0.0}.get(service)
        return response

    def step(self):
        """Its motion since the step before, which a busy computer makes longer."""
        passed_s, self.at_s = time.monotonic() - self.at_s, time.monotonic()
        self.heard_s += passed_s
        wanted = self.wanted if self.heard_s < SILENT_S else np.zeros(3)
        if self.target_m is not None:
            off = self.target_m - self.position[2]
            wanted = np.array([0.0, 0.0, np.clip(off, -CLIMB_M_S, CLIMB_M_S)])
        if self.armed:
            self.velocity += (1.0 - np.exp(-passed_s / LAG_S)) * (wanted - self.velocity)
            self.position += passed_s * self.velocity
            self.position[2] = max(self.position[2], 0.0)
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp = "map", self.node.get_clock().now().to_msg()
        point = pose.pose.position
        point.x, point.y, point.z = self.position.tolist()
        if self.told:
            self.poses.publish(pose)


def main():
    """Fly the vehicles of a scenario until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node("point_masses")
    scenario = load_scenario(sys.argv[1] if len(sys.argv) > 1 else "lab_4")
    masses = [
        PointMass(
            node, f"uav{uav.id}", (*uav.position_m[:2], 0.0), scenario.mavlink.takeoff_height_m
        )
        for uav in scenario.uavs
    ]
    print(f"{len(masses)} vehicles", flush=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
