"""Calls of the executor end in time."""

import pytest

pytest.importorskip("rclpy")


@pytest.mark.ros
def test_a_slice_ends_although_more_is_waiting(ros):
    """A recorder that is behind must see the signal that ends it, and take in the rest for so long at most."""
    from rclpy.duration import Duration
    from std_msgs.msg import Empty

    from ptnsbc_nodes.runtime.executor import BoundedSpin

    node, slices, heard = ros.node("behind"), BoundedSpin(ros.executor), []

    def on_message(message):
        heard.append(message)
        slices.look()

    node.create_subscription(Empty, "many", on_message, 100)
    publisher = node.create_publisher(Empty, "many", 100)
    ros.spin_until(publisher.get_subscription_count)
    ros.spin_for(
        0.01
    )  # what has come before the executor knows the subscription is one event to it
    for _ in range(100):
        publisher.publish(Empty())
    assert publisher.wait_for_all_acked(Duration(seconds=5))
    slices.serve(0.0)
    assert len(heard) < 100
    slices.drain(lambda: len(heard), quiet_s=0.2, limit_s=10.0)
    assert len(heard) == 100
