"""Names, types and delivery of every topic of the formation."""

from __future__ import annotations

import pytest

from ptnsbc_nodes import topics
from ptnsbc_nodes.bag.msgdef import definition


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
    for topic in (*topics.recorded([1]), topics.TF):
        assert definition(topic.type).type_hash.startswith("RIHS01_")


@pytest.mark.parametrize("available", [True, False])
def test_tf_only_where_it_can_be_used(monkeypatch, available):
    monkeypatch.setattr(topics, "tf_is_available", lambda: available)
    assert (topics.TF in topics.recorded([1, 2])) == available


def test_classes():
    pytest.importorskip("rclpy")
    for topic in topics.recorded([1]):
        package, _, name = topic.type.split("/")
        kind = topics.message_class(topic)
        assert (kind.__module__.split(".")[0], kind.__name__) == (package, name)


@pytest.mark.parametrize("lockstep", [False, True])
def test_recorder_fits_every_publisher(lockstep):
    rclpy_qos = pytest.importorskip("rclpy.qos")
    from ptnsbc_nodes import qos

    for topic in topics.recorded([1]):
        offered = qos.profile(topic, lockstep=lockstep)
        requested = qos.recorder_profile(topic, lockstep=lockstep)
        fit, reason = rclpy_qos.qos_check_compatible(offered, requested)
        # A warning says that liveliness is left to the system on both sides, as is usual.
        assert fit != rclpy_qos.QoSCompatibility.ERROR, reason
        state = topic.role is topics.Role.STATE
        reliable = offered.reliability == rclpy_qos.QoSReliabilityPolicy.RELIABLE
        assert reliable == (lockstep or not state)
