"""Messages and the GIDs of their publishers, by both executors of rclpy."""

import pytest

pytest.importorskip("rclpy")

from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Header

from ptnsbc_io import wire
from ptnsbc_nodes.comm import qos
from ptnsbc_nodes.comm.senders import taking
from ptnsbc_nodes.comm.senders.taking import tell_gids

pytestmark = pytest.mark.ros

DEEP = qos.keep_last(100, reliable=True)


class Air:
    """Two publishers and a subscription of one topic."""

    def __init__(self, ros, profile=DEEP):
        self.ros = ros
        self.reader = ros.node("reader")
        self.publishers = [
            ros.node(name).create_publisher(Header, "/x", profile) for name in ("one", "two")
        ]
        self.unsorted, self.taken = [], []
        self.subscription = self.reader.create_subscription(
            Header, "/x", self.unsorted.append, profile, raw=True
        )

    def match(self):
        self.ros.spin_until(lambda: self.subscription.get_publisher_count() == 2)
        self.ros.spin_until(
            lambda: all(one.get_subscription_count() == 1 for one in self.publishers)
        )

    def gids(self):
        found = self.reader.get_publishers_info_by_topic("/x")
        return {info.node_name: bytes(info.endpoint_gid) for info in found}


def message(text):
    return wire.HeaderTemplate(text).encode(1)


def test_each_message_comes_once_and_with_the_gid_that_the_graph_shows(ros):
    air = Air(ros)
    tell_gids(air.subscription, air.taken.append)
    air.match()
    for k in range(5):
        for name, publisher in zip(("one", "two"), air.publishers, strict=True):
            publisher.publish(message(f"{name} {k}"))
    ros.spin_until(lambda: len(air.taken) == 10)
    gids = air.gids()
    assert gids["one"] != gids["two"]
    for name, gid in gids.items():
        assert [one for one in air.taken if one.gid == gid] == [
            (message(f"{name} {k}"), gid, k + 1) for k in range(5)
        ]
    assert air.unsorted == []


def test_large_messages_come_whole_and_their_memory_is_given_back(ros):
    air = Air(ros)
    tell_gids(air.subscription, air.taken.append)
    air.match()
    texts = ["small", "x" * (3 << 20), "small again"]
    for text in texts:
        air.publishers[0].publish(message(text))
    ros.spin_until(lambda: len(air.taken) == 3)
    assert [one.data for one in air.taken] == [message(text) for text in texts]
    assert air.subscription._taker._message.capacity <= 1 << 20


def test_the_executor_without_events_gets_them_too(ros):
    air = Air(ros)
    tell_gids(air.subscription, air.taken.append)
    air.match()
    ros.executor.remove_node(air.reader)
    ros.spin_for(0.01)
    executor = SingleThreadedExecutor(context=ros.context)
    executor.add_node(air.reader)
    air.publishers[1].publish(message("two"))
    while not air.taken:
        executor.spin_once(timeout_sec=1.0)
    executor.shutdown()
    ros.executor.add_node(air.reader)
    assert air.taken == [(message("two"), air.gids()["two"], 1)]


@pytest.mark.parametrize("library", [False, True])
def test_without_the_structures_of_jazzy_messages_come_without_a_gid(ros, monkeypatch, library):
    """The first by our call, which finds no GID, and all others from rclpy."""
    rcl = taking._rcl()._replace(implementation=1) if library else None
    monkeypatch.setattr(taking, "_rcl", lambda: rcl)
    air = Air(ros)
    tell_gids(air.subscription, air.taken.append)
    air.match()
    for k in range(3):
        air.publishers[0].publish(message(str(k)))
    ros.spin_until(lambda: len(air.taken) == 3)
    assert air.taken == [(message(str(k)), b"", k + 1) for k in range(3)]
    assert air.unsorted == []


def test_a_message_that_comes_between_the_calls_of_ours_and_of_rclpy_has_its_number(ros):
    air = Air(ros)
    tell_gids(air.subscription, air.taken.append)
    air.match()
    air.subscription._taker.take = lambda: None  # as if nothing had come yet
    air.publishers[0].publish(message("late"))
    ros.spin_until(lambda: air.taken)
    assert air.taken == [(message("late"), b"", 1)]
