"""The launcher's node: what it believes of the messages of others."""

import time

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration

from ptnsbc_io.wire import HeaderTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.qos import RECORDER_RELIABLE
from ptnsbc_nodes.comm.topics import READY
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.runtime.watchdog import ENDED_S, WAITED

pytestmark = pytest.mark.ros


def spin_until(launcher, condition):
    """Serve the launcher; a condition that never comes about fails the test, and does not hang it."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "not within 60 s"
        launcher.spin(0.02)


def test_no_message_ends_the_launcher_or_makes_it_end_a_uav(ros):
    """`waited_s=100` once had all UAVs killed; a bad float ended the launcher."""
    others = Endpoints(ros.node("others"), lockstep=True)
    send = [others.publisher(topic, 0) for topic in (READY, topics.DIAGNOSTICS)]
    with LauncherNode(ros.domain) as launcher:
        spin_until(
            launcher,
            lambda: all(one.publisher.get_subscription_count() for one in others._published),
        )
        names = ", ".join(f"uav{i}" for i in range(1, 6))
        for waited in ("100", "1e9", "many", 5000 * "9"):
            values = {"ready": "false", "waiting_for": names, WAITED: waited}
            for publish in send:
                publish(diagnostics(0, "sim: world", DiagnosticLevel.ERROR, "", values))
        for publish in send:
            publish(b"\0\1\0\0\xff\xff\xff\xff")
            publish(b"nonsense")
        spin_until(launcher, lambda: sum(launcher.endpoints.refusals.counts.values()) >= 4)
        assert launcher.status.waiting["sim"] == names
        assert all(waited_s < ENDED_S for waited_s in launcher.status.stuck().values())


def test_a_launcher_that_has_left_the_network_is_seen_no_more(ros):
    other = ros.node("other")
    with LauncherNode(ros.domain) as launcher:
        spin_until(launcher, lambda: "fleet" in other.get_node_names())
        launcher.leave()
        ros.spin_until(lambda: "fleet" not in other.get_node_names())
        launcher.leave()


def test_statuses_of_the_largest_fleet_that_come_at_once_are_all_heard(ros):
    """UAVs of one process send together; the launcher started a process again that it had not heard."""
    sender = ros.node("uavs").create_publisher(DiagnosticArray, READY.name, RECORDER_RELIABLE)
    names = {f"uav{i}" for i in range(1, 255)}
    with LauncherNode(ros.domain) as launcher:
        spin_until(launcher, lambda: sender.get_subscription_count())
        for name in names:
            values = {"ready": "true"}
            sender.publish(diagnostics(0, f"{name}: planner", DiagnosticLevel.OK, "", values))
        assert sender.wait_for_all_acked(Duration(seconds=30))
        launcher.spin(1.0)
        assert launcher.status.waiting.keys() == names


def test_the_launcher_hears_when_the_first_leg_begins(ros):
    """By the wall clock; later legs do not change it."""
    tell = Endpoints(ros.node("leader"), lockstep=False).publisher(topics.EPOCH, 1)
    with LauncherNode(ros.domain) as launcher:
        launcher.leader.listen_for_start()
        assert (launcher.leader.begun, launcher.leader.begins_in_s()) == (False, 0.0)
        first_ns = time.time_ns() + 1_000_000_000_000
        tell(HeaderTemplate("form").encode(first_ns))
        spin_until(launcher, lambda: launcher.leader.begun)
        left_s = (first_ns - time.time_ns()) * 1e-9
        assert 0.0 < launcher.leader.begins_in_s() <= left_s <= 1000.0
        tell(HeaderTemplate("hold").encode(0))
        launcher.spin(0.2)
        assert launcher.leader.begins_in_s() > 0.0
