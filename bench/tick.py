"""One tick of a bridge in formation: of vehicles behind topics of ROS, beside those of MAVLink in the same process.

In it are what a vehicle tells between two ticks, the procedure, and the setpoint as bytes on its way, of the fleets of
the tests. ROS hands its bytes of a pose over in another thread, which is not in the figure; MAVLink's are in it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import rclpy
from geometry_msgs.msg import TwistStamped

from bench.session import Plan, own_domain, take_turns
from bench.table import Row, Target
from ptnsbc_nodes.bridge.bridge import Bridge
from ptnsbc_nodes.bridge.ros_vehicle.link import RosLink
from ptnsbc_nodes.bridge.ros_vehicle.topics import TopicLink
from ptnsbc_sim.scenario import load_scenario


def tick_us(fleet: Any, duration_s: float) -> float:
    """CPU time of a tick of one bridge [µs] in the mean of a fleet that flies on."""
    spent_s: list[float] = []

    def timed(call: Callable[..., None]) -> Callable[..., None]:
        def timed_call(*given: Any) -> None:
            began_s = time.thread_time()
            call(*given)
            spent_s.append(time.thread_time() - began_s)

        return timed_call

    serve, pose = timed(Bridge.serve), timed(RosLink.pose)
    with patch.object(Bridge, "serve", serve), patch.object(RosLink, "pose", pose):
        fleet.run(duration_s)
    rate_hz = fleet.scenario.mavlink.rate_hz * len(fleet.uavs)
    return 1e6 * sum(spent_s) / (duration_s * rate_hz)


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
    ros_fleet, mavlink_fleet = map(import_module, ("ros_fleet", "mavlink_fleet"))
    scenario = load_scenario("lab_4", {"timing.duration_s": 60.0})
    vehicle = scenario.bridged(ros=True).vehicle_link(1).ros
    assert vehicle is not None
    with own_domain():
        rclpy.init()
        node = rclpy.create_node("tick")
        node.create_subscription(TwistStamped, vehicle.output, print, 1)
        topics = TopicLink(node, vehicle, scenario.mavlink.takeoff_height_m)
        move = ros_fleet.PointMassLink.fly

        def fly(link: Any, *setpoint: Any) -> None:
            move(link, *setpoint)
            topics.fly(*setpoint)

        with patch.object(ros_fleet.PointMassLink, "fly", fly):
            ros = ros_fleet.RosFleet(scenario.bridged(ros=True)).airborne().form()
            mavlink = mavlink_fleet.MavlinkFleet(scenario.bridged()).airborne().form()
            turns = {"ros": lambda: tick_us(ros, 0.5), "mavlink": lambda: tick_us(mavlink, 0.5)}
            found = take_turns(turns, plan.of(9, 3))
        rclpy.shutdown()
    name, target = "tick of a bridge, by topics of ROS", Target(1.05, of_reference=True)
    return [Row(name, found["ros"], "µs", "by MAVLink", found["mavlink"], target=target)]
