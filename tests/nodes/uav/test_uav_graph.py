"""A UAV node among others: its names in the graph, its namespace, and the time that it follows."""

import contextlib

import numpy as np
import pytest
from own_services import PARAMETERS

pytest.importorskip("rclpy")

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.uav_node import UavNode
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

FOLLOWER, LEADER = 3, 1


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


@pytest.fixture
def started(ros, scenario):
    """Makes the node of one UAV, and starts it."""

    def make(uav_id, *, lockstep=False, namespace=None, cli_args=()):
        node = ros.node(
            "controller",
            namespace=f"/uav{uav_id}" if namespace is None else namespace,
            enable_rosout=False,
            cli_args=["--ros-args", *cli_args],
        )
        edges = CommunicationGraph(scenario, FlightOptions(lockstep=lockstep))
        uav = UavNode(node, scenario, uav_id, edges)
        uav.start()
        return uav

    return make


class Ear:
    """Real odometry for one UAV, and the wrenches it answers with."""

    def __init__(self, ros, uav_id):
        self.ends = Endpoints(ros.node("ear"), lockstep=False)
        self._send = self.ends.publisher(topics.odom(uav_id), 1)
        self.wrenches, self.status = [], []
        self.ends.listen(topics.wrench_setpoint(uav_id), bytes, self.wrenches.append)
        self.ends.listen(topics.DIAGNOSTICS, bytes, self.status.append)

    def odom(self, stamp_ns):
        body = np.zeros(13)
        body[6] = 1.0
        self._send(wire.OdometryTemplate("map", "x").encode(stamp_ns, body))


LEGS = {f"/formation/{leg}" for leg in ("start", "hold", "land", "stop")}


def shows(ros, ask, node, expected):
    """The graph is told to itself as to others: not at once."""

    def names():
        return {name for name, _ in ask(*node)}

    with contextlib.suppress(TimeoutError):
        ros.spin_until(lambda: names() == expected)
    assert names() == expected


@pytest.mark.parametrize("uav_id", [LEADER, FOLLOWER])
@pytest.mark.parametrize("lockstep", [False, True])
def test_the_graph_shows_what_the_architecture_lists(ros, started, uav_id, lockstep):
    node = started(uav_id, lockstep=lockstep).node
    me, here = ("controller", f"/uav{uav_id}"), f"/uav{uav_id}"
    says = {
        "setpoint/wrench", "setpoint/velocity", "formation_state", "leader_estimate", "robot_description",
        *(() if lockstep else ("tick", "snapshot")),
    }  # fmt: skip
    expected = {f"{here}/{name}" for name in says}
    expected |= {"/diagnostics", "/formation/ready", "/parameter_events"}
    expected |= {"/formation/epoch"} if uav_id == LEADER else set()
    shows(ros, node.get_publisher_names_and_types_by_node, me, expected)

    heard = {f"{here}/odom", f"{here}/near", "/formation/epoch", "/formation/lost"}
    heard |= {"/formation/request"} if uav_id == LEADER else set()
    if uav_id == FOLLOWER:  # its parent, the leader, and its neighbours in the estimator graph
        heard |= {"/uav2/formation_state", "/uav1/formation_state"}
        heard |= {"/uav2/leader_estimate", "/uav4/leader_estimate"}
    shows(ros, node.get_subscriber_names_and_types_by_node, me, heard)

    own = {f"{here}/controller/{name}" for name in PARAMETERS}
    own |= {f"{here}/controller/get_type_description"}
    own |= LEGS if uav_id == LEADER else set()
    shows(ros, node.get_service_names_and_types_by_node, me, own)


def test_a_namespace_and_a_remapping_are_honoured(started):
    uav = started(
        LEADER, cli_args=["-r", "__ns:=/red/uav1", "-r", "odom:=/somewhere/else"], namespace=""
    )
    node = uav.node
    said = {publisher.topic_name for publisher in node.publishers}
    heard = {subscription.topic_name for subscription in node.subscriptions}
    assert {"/red/uav1/setpoint/wrench", "/red/formation/epoch", "/red/diagnostics"} <= said
    assert {"/somewhere/else", "/red/uav1/near"} <= heard
    assert "/somewhere/else" in uav.waiting_for()
    services = {service.srv_name for service in node.services}
    assert "/red/formation/start" in services


def test_simulated_time_ticks_with_the_clock(ros, started):
    from rosgraph_msgs.msg import Clock

    started(LEADER, cli_args=["-p", "use_sim_time:=true"])
    ear = Ear(ros, LEADER)
    clock = ros.node("clock").create_publisher(Clock, "/clock", 1)
    ros.spin_until(lambda: not ear.ends.unheard() and not ear.ends.unread())
    ros.spin_until(lambda: clock.get_subscription_count() > 0)
    ear.odom(5_000_000_000)
    ros.spin_for(0.1)
    assert ear.wrenches == []  # by the wall clock there would have been ten
    now = 5.0

    def ticked():
        nonlocal now
        now += 0.01
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(now), round((now % 1) * 1e9)
        clock.publish(message)
        return len(ear.wrenches) >= 3

    ros.spin_until(ticked)
