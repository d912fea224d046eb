"""From a motion capture system to a flight controller: poses of a ROS topic become MAVLink ODOMETRY messages.

    python hardware/mocap_to_mavlink.py /vrpn_mocap/uav1/pose serial:/dev/ttyAMA1:921600 --system 1 --autopilot px4

The poses are those of the body (x forward, y left, z up) in the room (z up), as vrpn_mocap and NatNet clients of ROS
publish them. The link must be another one than the bridge's.
"""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import quaternion_enu_flu_to_ned_frd, vector_enu_to_ned
from ptnsbc_io.mavlink.transport import connect

FRAMES = {"px4": mavlink.MAV_FRAME_LOCAL_NED, "ardupilot": mavlink.MAV_FRAME_LOCAL_FRD}
"""The frame in which each autopilot takes a pose; the numbers are the same."""

_COMPANION = mavlink.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY


class Pose(NamedTuple):
    """A pose as ODOMETRY carries it."""

    position: tuple[float, float, float]  # [m] north, east, down of the room
    quaternion: tuple[float, float, float, float]  # w x y z, FRD in NED


def converted(position_enu: tuple[float, ...], xyzw: tuple[float, ...]) -> Pose | None:
    """The pose in the axes of MAVLink; None for one that holds no position or rotation."""
    length = math.sqrt(sum(q * q for q in xyzw))
    if not all(map(math.isfinite, (*position_enu, *xyzw))) or not 0.9 < length < 1.1:
        return None
    x, y, z = vector_enu_to_ned(np.array(position_enu)).tolist()
    w, a, b, c = quaternion_enu_flu_to_ned_frd(np.array(xyzw) / length).tolist()
    return Pose((x, y, z), (w, a, b, c))


def odometry(pose: Pose, stamp_us: int, autopilot: str) -> Any:
    """The message of a pose; what motion capture does not measure is NaN."""
    still, unknown = (math.nan,) * 3, [math.nan] * 21
    frames = (FRAMES[autopilot], mavlink.MAV_FRAME_BODY_FRD)
    kind = mavlink.MAV_ESTIMATOR_TYPE_MOCAP
    return mavlink.MAVLink_odometry_message(
        stamp_us,
        *frames,
        *pose.position,
        pose.quaternion,
        *still,
        *still,
        unknown,
        unknown,
        0,
        kind,
    )


def main() -> None:
    """Forward poses until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("topic", help="geometry_msgs/PoseStamped")
    parser.add_argument("connect", help="serial:DEVICE:BAUD or udpout:ADDRESS:PORT")
    parser.add_argument("--system", type=int, required=True, help="system id of the vehicle")
    parser.add_argument("--autopilot", choices=FRAMES, required=True)
    given = parser.parse_args()

    import rclpy
    from geometry_msgs.msg import PoseStamped
    from rclpy.qos import qos_profile_sensor_data

    link = connect(given.connect)
    writer = mavlink.MAVLink(None, srcSystem=given.system, srcComponent=_COMPANION)
    refused = 0

    def forward(message: PoseStamped) -> None:
        nonlocal refused
        at, turn = message.pose.position, message.pose.orientation
        pose = converted((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
        if pose is None:  # markers are hidden: the vehicle must notice that nothing comes
            refused += 1
            return
        stamp_us = message.header.stamp.sec * 1_000_000 + message.header.stamp.nanosec // 1000
        link.send(odometry(pose, stamp_us, given.autopilot).pack(writer), None)

    rclpy.init()
    node = rclpy.create_node("mocap_to_mavlink")
    node.create_subscription(PoseStamped, given.topic, forward, qos_profile_sensor_data)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        print(f"{refused} poses refused", file=sys.stderr)


if __name__ == "__main__":
    main()
