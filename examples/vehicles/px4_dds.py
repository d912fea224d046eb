"""A PX4 behind the agent of uXRCE-DDS: px4_msgs below `/NAME/fmu`, in NED and FRD, with times of the agent in us."""

from importlib import import_module
from math import nan

import numpy as np

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


class Px4(RosLink):
    """One PX4; it climbs by setpoints, and says its state itself."""

    def __init__(self, node, vehicle, height_m):
        super().__init__()
        self.node, self.topics, self.system = node, f"/{vehicle.name}/fmu", 1
        self.hear("VehicleOdometry", "vehicle_odometry", self.on_odometry)
        self.hear("VehicleStatus", "vehicle_status", self.on_status)
        self.hear("VehicleLandDetected", "vehicle_land_detected", self.on_landed)
        self.keep = self.publisher("OffboardControlMode", "offboard_control_mode")
        self.setpoint = self.publisher("TrajectorySetpoint", "trajectory_setpoint")
        self.command_to = self.publisher("VehicleCommand", "vehicle_command")

    def hear(self, kind, topic, take):
        """Subscribe to a topic; from the second version of its message on its name ends in that."""
        found = getattr(import_module("px4_msgs.msg"), kind)
        version = getattr(found, "MESSAGE_VERSION", 0)
        name = f"{self.topics}/out/{topic}" + (f"_v{version}" if version else "")
        self.node.create_subscription(found, name, take, keep_last(10, reliable=False))

    def publisher(self, kind, topic):
        """A function that publishes a message of these fields, with the time."""
        found = getattr(import_module("px4_msgs.msg"), kind)
        out = self.node.create_publisher(
            found, f"{self.topics}/in/{topic}", keep_last(1, reliable=True)
        )

        def publish(**fields):
            now_us = self.node.get_clock().now().nanoseconds // 1000
            out.publish(found(timestamp=now_us, **fields))

        return publish

    def fly(self, position, velocity, acceleration, yaw):
        """OffboardControlMode and TrajectorySetpoint; where a velocity is wanted it leads, as by MAVLink."""
        position = position if velocity is None else None
        given = {"position": position, "velocity": velocity, "acceleration": acceleration}
        self.keep(**{name: value is not None for name, value in given.items()})
        ned = {
            name: [nan] * 3 if value is None else frames.vector_enu_to_ned(value).tolist()
            for name, value in given.items()
        }
        heading = frames.yaw_enu_to_ned(yaw)
        self.setpoint(**ned, jerk=[nan] * 3, yaw=heading, yawspeed=nan)

    def request(self, request):
        """A VehicleCommand; its effect shows in the vehicle's state."""
        if request in COMMANDS:
            command, first, second = COMMANDS[request]
            to = {"target_system": self.system, "target_component": 1, "from_external": True}
            self.command_to(command=command, param1=first, param2=second, param4=nan, **to)

    def on_odometry(self, message):
        """VehicleOdometry."""
        wxyz, velocity, rates = (
            np.array(v, float) for v in (message.q, message.velocity, message.angular_velocity)
        )
        quaternion = frames.quaternion_ned_frd_to_enu_flu(wxyz)
        body = frames.vector_frd_to_flu(velocity)
        if message.velocity_frame != BODY:
            body = rotation_from_quaternion(quaternion).T @ frames.vector_ned_to_enu(velocity)
        place = frames.vector_ned_to_enu(np.array(message.position, float))
        if message.pose_frame == NED and np.isfinite([*place, *quaternion, *body, *rates]).all():
            turn = frames.vector_frd_to_flu(rates)
            self.pose(1000 * message.timestamp_sample, place, quaternion, body, turn)

    def on_status(self, message):
        """VehicleStatus."""
        self.system = message.system_id
        mode = MODES.get(message.nav_state, FlightMode.OTHER)
        self.report(armed=message.arming_state == ARMED, mode=mode)

    def on_landed(self, message):
        """VehicleLandDetected."""
        self.report(landed=message.landed)
