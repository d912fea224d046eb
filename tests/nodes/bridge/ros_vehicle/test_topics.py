"""A vehicle by the names of its topics and services, in process and with executors of ROS."""

import math
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

sys.path.insert(0, str(Path(__file__).parents[4] / "examples" / "vehicles"))

import crazyswarm_node
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from point_masses import PointMass
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.cdr import encode
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.setpoints import SetpointMessages
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.topics import open_ros_link
from ptnsbc_sim.plugins import REFUSED, USER_CODE
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

UP = (None, np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]), 0.5)


def laboratory(**ros_keys):
    keys = {f"ros.{key}": value for key, value in ros_keys.items()}
    return load_scenario("lab_4", keys).bridged(ros=True)


@pytest.fixture
def opened(ros):
    """A vehicle of the laboratory, with other keys; its link."""

    def make(uav=1, **keys):
        return open_ros_link(ros.node("bridge"), laboratory(**keys), uav)

    return make


@pytest.fixture
def heard(ros):
    """The messages heard on a topic, and a function that publishes on one."""
    other = ros.node("other")

    def listen(kind, topic):
        got = []
        other.create_subscription(kind, topic, got.append, 10)
        return got

    def publish(message, topic, until):
        publisher = other.create_publisher(type(message), topic, 10)
        ros.spin_until(publisher.get_subscription_count)
        publisher.publish(message)
        ros.spin_until(until)

    listen.publish = publish
    return listen


def test_a_vehicle_of_mavlink_has_no_link_of_topics(ros):
    assert open_ros_link(ros.node("bridge"), load_scenario("lab_4").bridged(), 1) is None


@pytest.mark.parametrize("frame", ["enu", "ned"])
def test_poses_odometry_and_transforms_tell_where_it_is(opened, heard, frame):
    half = math.sqrt(0.5)
    north = {"enu": (0.0, 0.0, half, half), "ned": (0.0, 0.0, 0.0, 1.0)}[frame]
    place = {"enu": (1.0, 2.0, 3.0), "ned": (2.0, 1.0, -3.0)}[frame]

    def fill(point, turned):
        point.x, point.y, point.z = place
        turned.x, turned.y, turned.z, turned.w = north

    pose, odometry, transform = PoseStamped(), Odometry(), TransformStamped(child_frame_id="uav1")
    fill(pose.pose.position, pose.pose.orientation)
    fill(odometry.pose.pose.position, odometry.pose.pose.orientation)
    fill(transform.transform.translation, transform.transform.rotation)
    odometry.twist.twist.linear.y = 0.4
    other = TransformStamped(child_frame_id="uav2")
    messages = {
        "geometry_msgs/msg/PoseStamped": pose,
        "nav_msgs/msg/Odometry": odometry,
        "tf2_msgs/msg/TFMessage": TFMessage(transforms=[other, transform]),
    }
    for kind, message in messages.items():
        name = kind.rpartition("/")[2].lower()
        link = opened(pose=f"/{name}/v{{n}}", pose_type=kind, frame=frame)
        heard.publish(message, f"/{name}/v1", lambda link=link: link.position.any())
        assert link.position.tolist() == pytest.approx([1.0, 2.0, 3.0])
        assert link._yaw == pytest.approx(0.5 * math.pi)
        left = {"enu": 0.4, "ned": -0.4}[frame] if message is odometry else 0.0
        assert link.velocity.tolist() == pytest.approx([0.0, left, 0.0])


def test_what_is_no_pose_is_refused_and_counted(opened, heard):
    link, message = opened(), PoseStamped()
    message.pose.position.x = math.nan
    heard.publish(message, "/uav1/pose", lambda: link.counts)
    assert link.counts == {"/uav1/pose": 1}
    assert link.refusals.newest.startswith("/uav1/pose: [nan  0.  0.  0.  0.  0.  1.]: expected")
    assert not link.position.any()


def test_missing_topics_and_services_are_named_before_a_vehicle_is_armed(ros, opened):
    land = {"land": [{"service": "/{name}/land"}]}
    link, other = opened(services=land), ros.node("vehicle")

    def told(words, by=link):
        ros.spin_until(lambda: by.lacks() == words)

    told("nobody hears /uav1/cmd_vel as geometry_msgs/msg/TwistStamped")
    other.create_subscription(TwistStamped, "/uav1/cmd_vel", print, 10)
    told("nobody offers /uav1/land")
    other.create_service(Trigger, "/uav1/land", lambda _, response: response)
    told("")
    told("ros.services has no land", opened(services={"land": []}))


def test_setpoints_are_twists_and_a_position_is_flown_to_by_a_velocity(ros, opened, heard):
    link, got = opened(), heard(TwistStamped, "/uav1/cmd_vel")
    for setpoint in (UP, (np.array([0.0, 3.0, 4.0]), None, None, 0.0)):
        got.clear()
        ros.spin_until(lambda setpoint=setpoint: got or link.fly(*setpoint))
        message = got[0]
        if setpoint is UP:
            assert message.header.frame_id == "map"
            assert message.header.stamp.sec > 1e9
            assert message.twist.linear.z == 0.3
            assert message.twist.angular.z == pytest.approx(0.5)
    assert message.twist.linear.y == pytest.approx(0.6)  # at most 1 m/s
    assert message.twist.linear.z == pytest.approx(0.8)


def test_setpoints_are_a_type_of_the_user_with_a_mapping_of_fields(ros, opened, heard):
    fields = {
        "position": "pose.pose.position",
        "orientation": "pose.pose.orientation",
        "velocity": "twist.twist.linear",
        "acceleration": "twist.twist.angular",
    }
    keys = {"output": "/{name}/full", "output_type": "nav_msgs/msg/Odometry", "fields": fields}
    link, got = opened(**keys, frame="ned"), heard(Odometry, "/uav1/full")
    full = (np.array([1.0, 2.0, 3.0]), *UP[1:])
    ros.spin_until(lambda: got or link.fly(*full))
    pose, twist = got[0].pose.pose, got[0].twist.twist
    assert (pose.position.x, pose.position.y, pose.position.z) == (2.0, 1.0, -3.0)
    assert (twist.linear.x, twist.angular.z) == (0.2, -3.0)
    assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(
        0.5 * math.pi - 0.5
    )
    assert laboratory(**keys).vehicle_link(1).setpoint == "position_velocity"


def test_setpoints_are_points_of_a_trajectory_with_lists_of_one(ros, opened, heard):
    types = pytest.importorskip("trajectory_msgs.msg", reason="make test builds it where g++ is")
    point = types.MultiDOFJointTrajectoryPoint
    keys = {
        "output": "/{name}/point",
        "output_type": "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
        "fields": {
            "position": "transforms.0.translation",
            "orientation": "transforms.0.rotation",
            "velocity": "velocities.0.linear",
            "yaw_rate": "velocities.0.angular.z",
            "acceleration": "accelerations.0.linear",
        },
    }
    link, got = opened(**keys), heard(point, "/uav1/point")
    full = (np.array([4.0, 5.0, 6.0]), *UP[1:])
    ros.spin_until(lambda: got or link.fly(*full))
    (transform,), (velocity,), (acceleration,) = (
        got[0].transforms,
        got[0].velocities,
        got[0].accelerations,
    )
    place, turned = transform.translation, transform.rotation
    assert (place.x, place.y, place.z) == (4.0, 5.0, 6.0)
    assert (turned.z, turned.w) == pytest.approx((math.sin(0.25), math.cos(0.25)))
    assert (velocity.linear.x, velocity.linear.z) == (0.1, 0.3)
    assert velocity.angular.z == pytest.approx(0.5)
    assert (acceleration.linear.x, acceleration.linear.z) == (1.0, 3.0)


def test_services_are_called_in_turn_and_their_answer_counts(ros, opened):
    server, called = ros.node("server"), []

    def on_set(request, response):
        called.append(request.data)
        response.success = True
        return response

    def on_stop(_, response):
        called.append("stop")
        response.success, response.message = len(called) > 3, "not yet"
        return response

    server.create_service(SetBool, "/uav1/arm", on_set)
    server.create_service(Trigger, "/uav1/stop", on_stop)
    arm = {"service": "/{name}/arm", "type": "std_srvs/srv/SetBool", "request": {"data": True}}
    stop = {"service": "/{name}/stop"}
    services = {"arm": [arm, arm], "stop": [stop], "land": [{"service": "/nobody"}]}
    link = opened(services=services)
    ros.spin_until(lambda: all(c.service_is_ready() for c, _ in link._calls["arm"]))
    for request in (CommandRequest.OWN_MODE, CommandRequest.ARM):
        link.request(request)
    link.request(CommandRequest.ARM)  # not again while it is not answered
    ros.spin_until(lambda: link.armed)
    assert (link.mode, called) == (FlightMode.OWN, [True, True])
    texts = []

    def refused():
        texts.extend(m.text for m in link.poll(0.0) if m.get_type() == "STATUSTEXT")
        return texts

    link.request(CommandRequest.KILL)
    ros.spin_until(refused)
    assert link.armed
    link.request(CommandRequest.KILL)
    ros.spin_until(lambda: not link.armed)
    link.request(CommandRequest.LAND)
    refused()
    assert texts == ["disarm in flight: not yet", "land: /nobody: nobody offers this service"]


def test_without_services_it_is_armed_and_lands_when_somebody_says_so(opened):
    link = opened(services={})
    link.request(CommandRequest.ARM)
    assert link.armed
    link.request(CommandRequest.KILL)
    (text,) = [m.text for m in link.poll(0.0) if m.get_type() == "STATUSTEXT"]
    assert text == "disarm in flight: ros.services has no stop"


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"output_type": "no_msgs/msg/Such"}, "UAV 1: ros: No module named 'no_msgs'"),
        ({"output_type": "std_msgs/msg/Such"}, r"UAV 1: ros: .* no attribute 'Such'"),
        (
            {"fields": {"velocity": "twist.speed"}},
            "UAV 1: ros: twist.speed: speed: expected one of linear, angular",
        ),
        ({"fields": {"velocity": "header"}}, "UAV 1: ros: "),
        (
            {"services": {"arm": [{"service": "/arm", "request": {"data": True}}]}},
            r"UAV 1: ros: .* no attribute 'data'",
        ),
    ],
)
def test_types_and_fields_that_are_not_there_are_named(opened, keys, why):
    with pytest.raises(PtnsbcError, match=why):
        opened(**keys)


def test_a_vehicle_of_forty_lines_takes_off_and_lands(ros, opened):
    link = opened()
    mass = PointMass(ros.node("vehicle"), "uav1", (0.0, 0.0, 0.0), 0.3)
    ros.spin_until(link.alive)
    ros.spin_until(lambda: mass.armed or link.request(CommandRequest.ARM))
    ros.spin_until(lambda: link.armed)
    link.request(CommandRequest.TAKEOFF)
    ros.spin_until(lambda: link.position[2] > 0.2)
    ros.spin_until(lambda: link.mode is FlightMode.LAND or link.request(CommandRequest.LAND))
    ros.spin_until(lambda: link.down)


@pytest.fixture
def crazyflie(monkeypatch):
    """UAV 2 of `crazyflie_4` behind a stand-in of Crazyswarm2's server: its link, and the server."""
    for name, module in crazyswarm_node.MODULES.items():
        monkeypatch.setitem(sys.modules, name, module)
    server = crazyswarm_node.Server()
    return open_ros_link(server, load_scenario("crazyflie_4").bridged(ros=True), 2), server


def test_a_crazyflie_takes_off_flies_full_states_and_lands_by_its_own_planner(crazyflie):
    link, server = crazyflie
    assert (server.pose, server.output) == ("/tf", "/cf2/cmd_full_state")
    for request in (CommandRequest.ARM, CommandRequest.TAKEOFF, CommandRequest.OWN_MODE):
        link.request(request)
    assert link.armed
    assert [name for name, _ in server.called] == ["/cf2/takeoff"]
    assert (server.called[0][1].height, server.called[0][1].duration.sec) == (1.0, 2)
    link.fly(np.array([1.0, 2.0, 3.0]), *UP[1:])
    wanted = crazyswarm_node.FullState()
    wanted.header = link._message.header
    wanted.pose.position.x, wanted.pose.position.y, wanted.pose.position.z = 1.0, 2.0, 3.0
    wanted.pose.orientation.z, wanted.pose.orientation.w = math.sin(0.25), math.cos(0.25)
    wanted.twist.linear.x, wanted.twist.linear.y, wanted.twist.linear.z = UP[1].tolist()
    wanted.acc.x, wanted.acc.y, wanted.acc.z = UP[2].tolist()
    assert server.sent == [encode(wanted)]
    link.request(CommandRequest.LAND)
    assert [name for name, _ in server.called[1:]] == ["/cf2/notify_setpoints_stop", "/cf2/land"]
    assert server.called[2][1].height == pytest.approx(0.03)
    assert link.mode is FlightMode.LAND


def test_a_crazyflie_takes_velocities_by_another_mapping(crazyflie):
    _, server = crazyflie
    keys = {
        "ros.output": "/{name}/cmd_velocity_world",
        "ros.output_type": "crazyflie_interfaces/msg/VelocityWorld",
        "ros.fields": {"velocity": "vel"},
    }
    link = open_ros_link(server, load_scenario("crazyflie_4", keys).bridged(ros=True), 2)
    assert server.output == "/cf2/cmd_velocity_world"
    for position, wanted in ((None, UP[1]), (np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.5]))):
        link.fly(position, UP[1] if position is None else None, None, 0.5)
        sent = crazyswarm_node.VelocityWorld()
        sent.header = link._message.header
        sent.vel.x, sent.vel.y, sent.vel.z = wanted.tolist()
        assert server.sent[-1] == encode(sent)


def test_stop_with_kill_stops_the_motors_of_a_crazyflie(crazyflie):
    link, server = crazyflie
    link.request(CommandRequest.KILL)
    assert [name for name, _ in server.called] == ["/cf2/emergency"]


def test_poses_of_another_type_are_named_and_so_is_the_transform_that_is_awaited(crazyflie):
    link, server = crazyflie
    assert (link.lacks(), link.source) == ("", "/tf to cf2")
    server.offered = ("geometry_msgs/msg/PoseStamped",)
    assert link.lacks() == "/tf is geometry_msgs/msg/PoseStamped: expected tf2_msgs/msg/TFMessage"


def test_a_service_that_does_not_answer_is_named(crazyflie, monkeypatch):
    link, server = crazyflie
    server.answers, now_s = False, [100.0]
    monkeypatch.setattr("ptnsbc_nodes.bridge.ros_vehicle.topics.time.monotonic", lambda: now_s[0])
    for now_s[0] in (100.0, 101.0, 102.5):
        link.request(CommandRequest.TAKEOFF)
    assert [name for name, _ in server.called] == ["/cf2/takeoff"] * 2
    (text,) = [m.text for m in link.poll(0.0) if m.get_type() == "STATUSTEXT"]
    assert text == "take off: /cf2/takeoff: no answer"


def test_no_setpoint_follows_the_first_call_of_a_landing(crazyflie):
    """One that is heard after `land` ends the landing, and the Crazyflie hovers where it is."""
    link, server = crazyflie
    setpoint = SetpointMessages(AUTOPILOTS["ros"], 1).position_target(
        0.0, 0.3, velocity=np.zeros(3)
    )
    link.request(CommandRequest.OWN_MODE)
    server.answers = False
    link.request(CommandRequest.LAND)
    assert link.mode is FlightMode.OWN
    assert link.send(setpoint)
    assert server.sent == []
    server.answer("refused")
    assert link.send(setpoint)
    assert len(server.sent) == 1


def test_a_class_of_the_user_is_its_link_unless_no_code_may_run(ros, tmp_path, monkeypatch):
    code = """
    from ptnsbc_nodes.bridge.ros_vehicle.link import RosLink


    class Mine(RosLink):
        def __init__(self, node, vehicle, height_m):
            super().__init__()
            self.name, self.height_m = vehicle.name, height_m


    class Broken(Mine):
        def __init__(self, *given):
            raise OSError("no radio")
    """
    (tmp_path / "mine.py").write_text(textwrap.dedent(code))

    def opened(name):
        file = tmp_path / f"{name}.yaml"
        text = f"extends: lab_4\nname: mine\nplugins: {{vehicle: 'mine.py:{name}'}}\n"
        file.write_text(text)
        return open_ros_link(ros.node("bridge"), load_scenario(file).bridged(ros=True), 2)

    mine = opened("Mine")
    assert (mine.name, mine.height_m) == ("uav2", 2.0)
    with pytest.raises(PtnsbcError, match=r"UAV 2: .*mine\.py:Broken: no radio"):
        opened("Broken")
    with pytest.raises(PtnsbcError, match=r"mine\.py: Such: no such name: expected a class"):
        opened("Such")
    monkeypatch.setenv(USER_CODE, REFUSED)
    with pytest.raises(PtnsbcError, match="the code of a vehicle, which this command does not run"):
        opened("Mine")
