"""A vehicle by its topics and services, as the block `ros` of a scenario names them; only bytes on the tick."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.kinematics import yaw_of
from ptnsbc_io.cdr import Stamped, encode
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.transport import ConnectError
from ptnsbc_io.wire import OdometryDecoder, decode_pose, decode_transform
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.link import Given, RosLink
from ptnsbc_nodes.comm.door import Door
from ptnsbc_nodes.comm.qos import NO_READER_EVENTS, NO_WRITER_EVENTS, keep_last
from ptnsbc_sim.plugins.loader import named_in
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.ros import RosCall, RosVehicle

_GAIN_1_S, _FASTEST_M_S = 1.0, 1.0  # towards a position, of a vehicle that takes velocities alone
_ANSWER_S, _TAKE_OFF_S = 2.0, 10.0  # before a call without an answer, or a take-off, is repeated
_FREE = (CommandRequest.OWN_MODE, CommandRequest.ARM, CommandRequest.TAKEOFF)  # need no service


class TopicLink(RosLink):
    """A vehicle with one topic of its pose, one of setpoints, and services."""

    def __init__(self, node: Node, vehicle: RosVehicle, height_m: float) -> None:
        """`height_m`: of the take-off. Raises what says that a type or a field is not there."""
        super().__init__()
        self._node, self._vehicle, self._height_m = node, vehicle, height_m
        self._ned, of_many = vehicle.frame == "ned", vehicle.pose_type.endswith("TFMessage")
        self.source = f"{vehicle.pose} to {vehicle.name}" if of_many else vehicle.pose
        self._yaw, self._not_again_s = 0.0, dict[CommandRequest, float]()
        self._unanswered: Any = None
        decoders: Mapping[str, Callable[[bytes], Stamped | None]] = {
            "nav_msgs/msg/Odometry": OdometryDecoder(),
            "tf2_msgs/msg/TFMessage": lambda data: decode_transform(data, vehicle.name),
            "geometry_msgs/msg/PoseStamped": decode_pose,
        }
        self._pose = node.create_subscription(
            _class_of(vehicle.pose_type),
            vehicle.pose,
            Door(vehicle.pose, decoders[vehicle.pose_type], self._on_pose, self.refusals),
            keep_last(10, reliable=False),  # whatever is offered
            raw=True,
            event_callbacks=NO_READER_EVENTS,
        )
        kind, self._takes_position = _class_of(vehicle.output_type), "position" in vehicle.fields
        self._message = kind()
        self._writers = {
            name: _writer(self._message, place) for name, place in vehicle.fields.items()
        }
        self._publisher = node.create_publisher(
            kind, vehicle.output, keep_last(1, reliable=True), event_callbacks=NO_WRITER_EVENTS
        )
        self._calls: dict[str, list[tuple[Any, Any]]] = {
            request: [self._client(call) for call in calls]
            for request, calls in vehicle.services.items()
        }
        self._clients = [client for calls in self._calls.values() for client, _ in calls]

    def alive(self) -> bool:
        """True if somebody publishes its pose, or offers its services."""
        ready = any(client.service_is_ready() for client in self._clients)
        return ready or self._pose.get_publisher_count() > 0

    def lacks(self) -> str:
        """The first thing that is not there, by its name; then too few poses."""
        pose, kind = self._vehicle.pose, self._vehicle.pose_type
        offered = {one.topic_type for one in self._node.get_publishers_info_by_topic(pose)}
        if offered - {kind}:
            return f"{pose} is {', '.join(offered - {kind})}: expected {kind}"
        if not self._publisher.get_subscription_count():
            return f"nobody hears {self._vehicle.output} as {self._vehicle.output_type}"
        if not self._calls.get("land"):
            return "ros.services has no land"
        silent = [client.srv_name for client in self._clients if not client.service_is_ready()]
        return f"nobody offers {', '.join(silent)}" if silent else super().lacks()

    def fly(self, position: Given, velocity: Given, acceleration: Given, yaw: float) -> None:
        """Publish a setpoint; a position is flown to by a velocity where the messages have no position."""
        rest, yaw_rate = np.zeros(3), _GAIN_1_S * wrap_angle(yaw - self._yaw)
        if velocity is None and position is not None and not self._takes_position:
            off = _GAIN_1_S * (position - self.position)
            velocity = off * min(1.0, _FASTEST_M_S / max(math.hypot(*off), 1e-9))
        vectors: dict[str, Any] = {
            "position": self.position if position is None else position,
            "velocity": rest if velocity is None else velocity,
            "acceleration": rest if acceleration is None else acceleration,
        }
        if self._ned:
            vectors = {name: frames.vector_enu_to_ned(value) for name, value in vectors.items()}
            yaw, yaw_rate = frames.yaw_enu_to_ned(yaw), -yaw_rate
        turned = [0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]
        values = {**vectors, "orientation": turned, "yaw": [yaw], "yaw_rate": [yaw_rate]}
        for name, write in self._writers.items():
            write(values[name])
        if hasattr(self._message, "header"):
            self._message.header.frame_id = "map"
            self._message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(encode(self._message))  # a tenth of what rclpy takes

    def request(self, request: CommandRequest) -> None:
        """Call the services of a request, one after the other."""
        service = "stop" if request is CommandRequest.KILL else request.value.replace(" ", "_")
        calls = self._calls.get(service, [])
        if calls and time.monotonic() >= self._not_again_s.get(request, 0.0):
            self._call_in_turn(request, calls)
        elif calls:
            return
        elif request in _FREE or (self.down and request is not CommandRequest.LAND):
            self.done(request)
        elif request is CommandRequest.DISARM:
            self.request(CommandRequest.LAND)
        else:
            self.say(f"{request.value}: ros.services has no {service}")

    def _call_in_turn(self, request: CommandRequest, calls: Sequence[tuple[Any, Any]]) -> None:
        client, values = calls[0]
        ready = client.service_is_ready()
        self.silent = ready and request is CommandRequest.LAND
        if ready:
            if client is self._unanswered:
                self.say(f"{request.value}: {client.srv_name}: no answer")
            self._unanswered = client
            self._not_again_s[request] = time.monotonic() + _ANSWER_S
            answer = client.call_async(values)
            answer.add_done_callback(partial(self._on_answer, request, calls[1:]))
        else:
            self.say(f"{request.value}: {client.srv_name}: nobody offers this service")

    def _on_answer(self, request: CommandRequest, rest: Sequence[Any], answer: Any) -> None:
        self._unanswered = None
        result, takes_off = answer.result(), request is CommandRequest.TAKEOFF
        self._not_again_s[request] = time.monotonic() + _TAKE_OFF_S * takes_off
        if not getattr(result, "success", True):
            self._not_again_s[request], self.silent = 0.0, False
            self.say(f"{request.value}: {getattr(result, 'message', '') or 'refused'}")
        elif rest:
            self._call_in_turn(request, rest)
        else:
            self.done(request)

    def _client(self, call: RosCall) -> tuple[Any, Any]:
        """The client of a service, and the request with the values of the scenario."""
        kind = _class_of(call.type)

        def filled(message: Any, values: Mapping[str, Any]) -> Any:
            for key, value in values.items():
                own, given = getattr(message, key), self._height_m if value == "height_m" else value
                nested = isinstance(value, Mapping)
                setattr(message, key, filled(own, value) if nested else type(own)(given))
            return message

        return self._node.create_client(kind, call.service), filled(kind.Request(), call.request)

    def _on_pose(self, message: Stamped | None) -> None:
        if message is None:  # of other vehicles
            return
        position, quaternion, twist = np.split(message.values, (3, 7))
        moving = list(twist.reshape(-1, 3))
        if self._ned:
            position = frames.vector_ned_to_enu(position)
            quaternion = frames.quaternion_ned_frd_to_enu_flu(np.roll(quaternion, 1))
            moving = list(map(frames.vector_frd_to_flu, moving))
        self._yaw = yaw_of((0.0, 0.0, 0.0, *quaternion))
        self.pose(message.stamp_ns, position, quaternion, *moving)


def _class_of(text: str) -> Any:
    """The class of a type, `package/msg/Name` or `package/srv/Name`; ImportError or AttributeError without one."""
    package, kind, name = text.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


def _writer(message: Any, place: str) -> Callable[[Sequence[float]], None]:
    """A function that writes a number, a vector, a quaternion or an array at a place of a message.

    A number in the place is an entry of a list, which is made where it is missing.
    """
    owner, kind, value, key = message, "", message, ""
    for key in place.split("."):
        if isinstance(value, list):
            package, _, name = kind.partition("<")[2].rstrip(">").partition("/")
            value += [
                _class_of(f"{package}/msg/{name}")() for _ in range(int(key) + 1 - len(value))
            ]
            value = value[int(key)]
        else:
            fields: Mapping[str, str] = getattr(value, "get_fields_and_field_types", dict)()
            if key not in fields:
                known = ", ".join(fields) or "no fields"
                raise ConnectError(f"{place}: {key}: expected one of {known}")
            owner, kind, value = value, fields[key], getattr(value, key)
    if isinstance(value, float):
        return lambda numbers: setattr(owner, key, float(numbers[0]))
    if isinstance(value, np.ndarray):
        return lambda numbers: value.__setitem__(slice(None), numbers)
    axes = (*value.get_fields_and_field_types(),)

    def write(numbers: Sequence[float]) -> None:
        for axis, number in zip(axes, numbers, strict=True):
            setattr(value, axis, float(number))

    write((0.0,) * len(axes))  # refused here if these are no numbers
    return write


def open_ros_link(node: Node, scenario: Scenario, uav_id: int) -> Any:
    """The RosLink to the vehicle of a UAV, of the class that its scenario names; None for one that speaks MAVLink.

    Raises:
        ConnectError: its topics or services cannot be had.
        PluginError: the class of the user cannot be loaded.
    """
    settings, own = scenario.vehicle_link(uav_id), scenario.plugins.vehicle
    if settings.ros is None:
        return None
    file, _, name = (own or "").rpartition(":")
    kind = named_in(Path(file), name, "a vehicle", type) if own else TopicLink
    try:
        return kind(node, settings.ros, scenario.mavlink.takeoff_height_m)
    except Exception as error:
        why = " ".join(str(error).split())
        raise ConnectError(f"UAV {uav_id}: {own or 'ros'}: {why}") from error
