"""Names, types and delivery of every topic of the formation."""

from __future__ import annotations

import pytest

from ptnsbc_io.bag.metadata import definition
from ptnsbc_nodes.comm import topics


def test_names():
    assert [topic.name for topic in topics.of_uav(3)] == [
        "/uav3/odom",
        "/uav3/near",
        "/uav3/formation_state",
        "/uav3/leader_estimate",
        "/uav3/setpoint/velocity",
        "/uav3/setpoint/wrench",
    ]


def test_every_type_has_a_definition():
    for topic in topics.in_bag([1]):
        assert definition(topic.type).type_hash.startswith("RIHS01_")


def test_tf_is_in_every_bag_and_never_subscribed_to():
    assert topics.in_bag([1, 2]) == (*topics.recorded([1, 2]), topics.TF)
    assert topics.TF not in topics.recorded([1, 2])


def test_classes():
    pytest.importorskip("rclpy")
    for topic in topics.recorded([1]):
        package, _, name = topic.type.split("/")
        kind = topics.message_class(topic)
        assert (kind.__module__.split(".")[0], kind.__name__) == (package, name)


@pytest.mark.parametrize("lockstep", [False, True])
def test_recorder_fits_every_publisher(lockstep):
    rclpy_qos = pytest.importorskip("rclpy.qos")
    from ptnsbc_nodes.comm import qos

    for topic in topics.recorded([1]):
        offered = qos.profile(topic, lockstep=lockstep)
        requested = qos.recorder_profile(topic, lockstep=lockstep)
        fit, reason = rclpy_qos.qos_check_compatible(offered, requested)
        # A warning says that liveliness is left to the system on both sides, as is usual.
        assert fit != rclpy_qos.QoSCompatibility.ERROR, reason
        state = topic.role is topics.Role.STATE
        reliable = offered.reliability == rclpy_qos.QoSReliabilityPolicy.RELIABLE
        assert reliable == (lockstep or not state)
        assert requested.reliability == offered.reliability
