"""The raw ends of a node: who reads, who publishes, and what a process waits for at its end."""

import threading

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.duration import Duration

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints, fleet_namespace, wait_for_readers
from ptnsbc_nodes.comm.seal import Seal

pytestmark = pytest.mark.ros

HEADER = wire.HeaderTemplate("form")


def test_with_a_seal_the_messages_of_an_outsider_do_not_push_out_the_true_one(ros):
    """A queue of one held the newest message alone, which was a forged one."""
    seal, topic, taken = Seal(bytes(32)), topics.odom(1), []
    ours, theirs, reader = (
        Endpoints(ros.node(name), False, key)
        for name, key in (("ours", seal), ("theirs", None), ("recorder", seal))
    )
    reader.listen(topic, wire.decode_odometry, taken.append)
    true, forged = ours.publisher(topic, 1), theirs.publisher(topic, 1)
    ros.spin_until(lambda: not ours.unread() and not theirs.unread())
    ros.spin_until(lambda: reader._subscriptions[0].get_publisher_count() == 2)
    odometry = wire.OdometryTemplate("map", "uav1").encode(7, np.ones(13))
    true(odometry)
    for _ in range(10):  # before the reader has a chance to take one
        forged(odometry)
    ros.spin_until(lambda: reader.refusals.counts[topic.name] == 10)
    assert [message.stamp_ns for message in taken] == [7]


ODOMETRY = wire.OdometryTemplate("map", "uav1")


def test_the_last_word_is_sent_behind_the_states_and_waited_for(ros):
    """Nobody acknowledges a state that is sent with best effort."""
    sender, reader = (Endpoints(ros.node(name), lockstep=False) for name in ("sender", "recorder"))
    taken = []
    reader.listen(topics.odom(1), wire.decode_odometry, lambda _: taken.append("state"))
    reader.listen(topics.EPOCH, wire.decode_header, lambda _: taken.append("last word"))
    send, announce = sender.publisher(topics.odom(1), 1), sender.publisher(topics.EPOCH, 1)
    sender.last_word = lambda: announce(HEADER.encode(1))
    ros.spin_until(lambda: not sender.unread())
    send(ODOMETRY.encode(7, np.ones(13)))
    sender.last_word()
    sender.flush(30.0)
    assert sender._published[1].publisher.wait_for_all_acked(Duration())
    sender.close()
    ros.spin_until(lambda: sorted(taken) == ["last word", "state"])


@pytest.mark.parametrize("reader", [("recorder", ""), ("controller", "/uav2")])
def test_a_viewer_does_not_stand_in_for_a_node_that_is_not_found_yet(ros, reader):
    """A recorder missed the first seconds of a topic that a user read, and the flight waited for it for ever."""
    sender, topic = Endpoints(ros.node("sim"), lockstep=True), topics.odom(1)
    sender.publisher(topic, 1)
    nodes = [ros.node("viewer"), ros.node("recorder", namespace="/red")]
    for node in nodes:
        Endpoints(node, lockstep=True).listen(topic, wire.decode_odometry, print)
    (own,) = sender._published
    ros.spin_until(lambda: own.publisher.get_subscription_count() == 1)
    ros.spin_until(lambda: len(nodes[0].get_subscriptions_info_by_topic("/uav1/odom")) == 1)
    assert sender.unread() == ["/uav1/odom"]
    name, namespace = reader
    found = Endpoints(ros.node(name, namespace=namespace), lockstep=True)
    found.listen(topic, wire.decode_odometry, print)
    ros.spin_until(lambda: not sender.unread())


@pytest.mark.parametrize("seal", [None, Seal(bytes(32))])
def test_rivals_are_named_with_their_nodes_and_a_fleet_without_a_seal_waits_for_their_end(
    ros, seal
):
    """Two publishers may be of nodes with one name: a second fleet in the domain."""
    topic = topics.odom(1)
    reader = Endpoints(ros.node("reader"), False, seal)
    reader.listen(topic, wire.decode_odometry, print)
    names = ["sim", "outsider", "sim"]
    nodes = []
    for count, name in enumerate(names, start=1):
        nodes.append(ros.node(name))
        Endpoints(nodes[-1], False).publisher(topic, 1)
        ros.spin_until(lambda n=count: reader._subscriptions[0].get_publisher_count() == n)
        if count == 1:
            assert (reader.rivals(), reader.contested(), reader.warning()) == ([], [], "")
    named = f"{topic.name}: /outsider and /sim and /sim publish it"
    ros.spin_until(lambda: reader.rivals() == [named])
    assert reader.contested() == ([] if seal else [f"a single publisher of {named}"])
    assert reader.warning() == f"second publisher of {named}"
    for node in nodes[1:]:
        ros.remove(node)
    ros.spin_until(lambda: reader.rivals() == [])


def test_all_publishers_of_a_shared_topic_are_heard(ros):
    taken, reader = [], Endpoints(ros.node("recorder"), lockstep=False)
    reader.shared.add(topics.SLOTS.name)
    for topic in (topics.EMERGENCY, topics.SLOTS):
        reader.listen(topic, wire.decode_header, taken.append)
    for name in ("ours", "theirs"):
        ends = Endpoints(ros.node(name), lockstep=False)
        for topic in (topics.EMERGENCY, topics.SLOTS):
            ends.publisher(topic, 1)(HEADER.encode(7))
            ros.spin_until(lambda ends=ends: not ends.unread())
    ros.spin_until(lambda: len(taken) == 4)
    assert all(end.get_publisher_count() == 2 for end in reader._subscriptions)
    assert reader.rivals() == []


def test_with_a_seal_an_outsider_that_was_there_first_does_not_keep_the_topic(ros):
    """The seal tells who is who: with it the first publisher has no advantage."""
    seal, taken = Seal(bytes(32)), []
    theirs, reader = Endpoints(ros.node("outsider"), False), Endpoints(ros.node("r"), False, seal)
    reader.listen(topics.EPOCH, wire.decode_header, taken.append)
    forge = theirs.publisher(topics.EPOCH, 1)
    forge(HEADER.encode(7))
    ros.spin_until(lambda: reader.refusals.counts)
    ours = Endpoints(ros.node("leader"), False, seal)
    ours.publisher(topics.EPOCH, 1)(HEADER.encode(8))
    ros.spin_until(lambda: taken)
    assert [one.stamp_ns for one in taken] == [8]


def test_nothing_listens_for_events_of_the_quality_of_service(ros):
    """A recorder that counted lost messages waited for a lock of the middleware for ever."""
    endpoints = Endpoints(ros.node("both"), lockstep=False)
    endpoints.publisher(topics.odom(1), 0)
    endpoints.listen(topics.odom(2), wire.decode_odometry, list().append)
    ends = [*endpoints._node.subscriptions, *(one.publisher for one in endpoints._published)]
    assert len(ends) == 2
    assert [handler for one in ends for handler in one.event_handlers] == []


class _UnreadPublisher:
    """A publisher whose reader answers as soon as another thread of this process has had its turn."""

    def __init__(self):
        self.read = threading.Event()
        self.waited_ns = 0

    def wait_for_all_acked(self, timeout):
        self.waited_ns += timeout.nanoseconds
        return self.read.is_set()


def test_other_threads_act_while_a_process_waits_for_its_readers():
    """rclpy keeps Python's lock inside `wait_for_all_acked`: a bridge could not say for 3 s that its motors stood."""
    publisher = _UnreadPublisher()
    other = threading.Thread(target=publisher.read.set)
    other.start()
    assert wait_for_readers([publisher], 60.0)
    assert publisher.waited_ns == 0
    other.join()


def test_readers_that_do_not_answer_end_the_wait_when_it_is_over():
    publisher = _UnreadPublisher()
    assert not wait_for_readers([publisher], 0.0)
    publisher.read.set()
    assert wait_for_readers([publisher], 0.0)


@pytest.mark.parametrize(
    ("namespace", "fleet"),
    [("/", ""), ("/uav3", ""), ("/a", "/a"), ("/a/uav3", "/a"), ("/a/b/uav12", "/a/b")],
)
def test_names_are_relative_to_the_namespace_of_the_fleet(namespace, fleet):
    assert fleet_namespace(namespace) == fleet
