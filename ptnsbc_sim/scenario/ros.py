"""The `ros` block: vehicles behind topics and services of ROS 2, in place of MAVLink."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from ptnsbc_sim.scenario.fields import Block, UavId

MessageType = Annotated[str, Field(pattern=r"^\w+/(msg|srv)/\w+$")]
Request = Literal["arm", "disarm", "take_off", "land", "stop"]
Quantity = Literal["position", "velocity", "acceleration", "orientation", "yaw", "yaw_rate"]
_TWIST: dict[Quantity, str] = {"velocity": "twist.linear", "yaw_rate": "twist.angular.z"}


class RosCall(Block):
    """A call of a service."""

    service: str
    """Its name."""
    type: MessageType = "std_srvs/srv/Trigger"
    """Its type."""
    request: dict[str, Any] = Field(default_factory=dict)
    """Values of its request, nested as there; the text `height_m` stands for `mavlink.takeoff_height_m`."""


class RosVehicle(Block):
    """Topics and services of one vehicle; `{n}` in a text is the UAV id, `{name}` the vehicle's name."""

    name: str = "uav{n}"
    """Name of the vehicle."""
    pose: str = "/{name}/pose"
    """Topic of its pose."""
    pose_type: Literal[
        "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
    ] = "geometry_msgs/msg/PoseStamped"
    """Type of the pose; of a TFMessage the transform whose `child_frame_id` is the vehicle's name counts."""
    frame: Literal["enu", "ned"] = "enu"
    """Axes of all its topics: x east, y north, z up, body forward-left-up; or north, east, down, forward-right-down."""
    output: str = "/{name}/cmd_vel"
    """Topic of its setpoints."""
    output_type: MessageType = "geometry_msgs/msg/TwistStamped"
    """Type of the setpoints."""
    fields: dict[Quantity, str] = Field(default_factory=lambda: dict(_TWIST))
    """Place of each quantity in a setpoint. Default: `{velocity: twist.linear, yaw_rate: twist.angular.z}`."""
    services: dict[Request, tuple[RosCall, ...]] = Field(default_factory=dict)
    """Services that are called in turn, for each request; `stop` stops the motors in flight as well."""


class Ros(RosVehicle):
    """Vehicles behind topics and services, see [vehicles.md](vehicles.md)."""

    vehicles: dict[UavId, RosVehicle] = Field(default_factory=dict)
    """The same keys for single vehicles, by UAV id."""

    def vehicle(self, uav_id: int) -> RosVehicle:
        """The topics and services of one UAV, with all names filled in."""
        own = self.vehicles.get(uav_id, RosVehicle())
        one = self.model_copy(update={key: getattr(own, key) for key in own.model_fields_set})
        text = one.model_dump_json(exclude={"vehicles"})
        text = text.replace("{name}", one.name).replace("{n}", str(uav_id))
        return RosVehicle.model_validate_json(text)
