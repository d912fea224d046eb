"""A PX4 behind the agent of uXRCE-DDS: px4_msgs below `/NAME/fmu`, in NED and FRD, with times of the agent in us."""

import re
from math import nan

import numpy as np
from px4_msgs import msg as px4_msgs

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.link import RosLink
from ptnsbc_nodes.comm.qos import keep_last

ARMED, NED, BODY = 2, 1, 3  # ARMING_STATE_ARMED, POSE_FRAME_NED, VELOCITY_FRAME_BODY_FRD
MODES = {  # by NAVIGATION_STATE
    4: FlightMode.HOLD, 5: FlightMode.RETURN, 12: FlightMode.LAND, 14: FlightMode.OWN, 17: FlightMode.TAKEOFF,
    18: FlightMode.LAND, 20: FlightMode.LAND,
}  # fmt: skip
COMMANDS = {  # VEHICLE_CMD and its first two parameters
    CommandRequest.OWN_MODE: (176, 1.0, 6.0), CommandRequest.ARM: (400, 1.0, 0.0),
    CommandRequest.DISARM: (400, 0.0, 0.0), CommandRequest.KILL: (400, 0.0, 21196.0),
    CommandRequest.LAND: (21, 0.0, 0.0),
}  # fmt: skip


def topic_of(kind):
    """VehicleOdometry: vehicle_odometry."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind).lower()


def in_ned(vector):
    """(3,) as PX4 takes it; what is None is left to it."""
    return [nan] * 3 if vector is None else frames.vector_enu_to_ned(vector).tolist()


class Px4(RosLink):
    """One PX4; it climbs by setpoints, and says its state itself."""

    def __init__(self, node, vehicle, height_m):
        super().__init__()
        self.node, self.fmu, self.system = node, f"/{vehicle.name}/fmu", 1
        self.source, self.publishers = f"{self.fmu}/out", {}
        self.hear("VehicleOdometry", self.on_odometry)
        self.hear("VehicleStatus", self.on_status)
        self.hear("VehicleLandDetected", lambda message: self.report(landed=message.landed))

    def hear(self, kind, take):
        """Subscribe to a topic; from the second version of its message on its name ends in that."""
        found = getattr(px4_msgs, kind)
        version = getattr(found, "MESSAGE_VERSION", 0)
        topic = f"{self.fmu}/out/{topic_of(kind)}" + (f"_v{version}" if version else "")
        self.node.create_subscription(found, topic, take, keep_last(10, reliable=False))

    def tell(self, kind, **fields):
        """Publish a message of these fields, with the time."""
        found, topic = getattr(px4_msgs, kind), f"{self.fmu}/in/{topic_of(kind)}"
        if kind not in self.publishers:
            newest = keep_last(1, reliable=True)
            self.publishers[kind] = self.node.create_publisher(found, topic, newest)
        now_us = self.node.get_clock().now().nanoseconds // 1000
        self.publishers[kind].publish(found(timestamp=now_us, **fields))

    def fly(self, position, velocity, acceleration, yaw):
        """OffboardControlMode and TrajectorySetpoint; where a velocity is wanted it leads, as by MAVLink."""
        position = position if velocity is None else None
        given = {"position": position, "velocity": velocity, "acceleration": acceleration}
        ned = {name: in_ned(vector) for name, vector in given.items()}
        self.tell("OffboardControlMode", **{name: v is not None for name, v in given.items()})
        heading = frames.yaw_enu_to_ned(yaw)
        self.tell("TrajectorySetpoint", **ned, jerk=[nan] * 3, yaw=heading, yawspeed=nan)

    def request(self, request):
        """A VehicleCommand; its effect shows in the vehicle's state."""
        if request in COMMANDS:
            numbers = dict(zip(("command", "param1", "param2"), COMMANDS[request], strict=True))
            to = {"target_system": self.system, "target_component": 1, "from_external": True}
            self.tell("VehicleCommand", **numbers, **to, param4=nan)

    def on_odometry(self, message):
        """VehicleOdometry; what is not finite is refused by `pose`."""
        given = (message.q, message.position, message.velocity, message.angular_velocity)
        wxyz, place, velocity, rates = (np.array(numbers, float) for numbers in given)
        quaternion = frames.quaternion_ned_frd_to_enu_flu(wxyz)
        body = frames.vector_frd_to_flu(velocity)
        if message.velocity_frame != BODY:
            body = rotation_from_quaternion(quaternion).T @ frames.vector_ned_to_enu(velocity)
        if message.pose_frame == NED:
            turn, position = frames.vector_frd_to_flu(rates), frames.vector_ned_to_enu(place)
            self.pose(1000 * message.timestamp_sample, position, quaternion, body, turn)

    def on_status(self, message):
        """VehicleStatus."""
        self.system = message.system_id
        mode = MODES.get(message.nav_state, FlightMode.OTHER)
        self.report(armed=message.arming_state == ARMED, mode=mode)
