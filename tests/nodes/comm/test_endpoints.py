"""What a process says it has sent."""

import threading
from functools import partial

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.duration import Duration

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints, sent_in, wait_for_readers
from ptnsbc_nodes.comm.seal import Seal

pytestmark = pytest.mark.ros

HEADER = wire.HeaderTemplate("form")


def test_every_message_counts_and_those_before_the_first_leg_apart(ros):
    endpoints = Endpoints(ros.node("sender"), lockstep=False)
    announce = endpoints.publisher(topics.EPOCH, 0)
    tell_time = endpoints.publisher(topics.CLOCK, 0)
    announce(HEADER.encode(1))
    assert sent_in([endpoints.account()]).since_ns == -1
    endpoints.begin(77)
    endpoints.begin(99)  # a second leg changes nothing
    for stamp in range(3):
        tell_time(wire.ClockTemplate().encode(stamp))
    found = sent_in(["something else", endpoints.account(), "the end"])
    assert (found.since_ns, found.before) == (77, {"/formation/epoch": 1, "/clock": 0})
    assert found.sent == {"/formation/epoch": 1, "/clock": 3}


def test_a_process_that_was_killed_says_nothing():
    assert sent_in(["ready", "sent"]) is None


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
    sender.end_with(lambda: announce(HEADER.encode(1)))
    ros.spin_until(lambda: not sender.unread())
    send(ODOMETRY.encode(7, np.ones(13)))
    sender.say_last_word()
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


class Rivals:
    """A node of the fleet that publishes a topic, an outsider that joins later, and a reader."""

    def __init__(self, ros, topic, lockstep=False, seal=None, decode=wire.decode_header):
        self.ros, self.topic, self.taken = ros, topic, []
        self.ours, self.theirs, self.reader = (
            Endpoints(ros.node(name), lockstep, key)
            for name, key in (("uav1", seal), ("outsider", None), ("recorder", seal))
        )
        self.reader.listen(topic, decode, self.taken.append)
        self.send = self.ours.publisher(topic, 1)
        ros.spin_until(lambda: not self.ours.unread())
        ros.spin_until(lambda: not self.reader.unheard())
        assert self.reader.rivals() == ""

    def heard(self, count):
        return len(self.taken) == count

    def join(self, ends=None):
        ends = ends or self.theirs
        send = ends.publisher(self.topic, 1)
        self.ros.spin_until(lambda: not ends.unread())
        self.ros.spin_until(lambda: self.reader._subscriptions[0].get_publisher_count() == 2)
        return send


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("topic", [topics.EPOCH, topics.TAKEN])
def test_a_second_publisher_of_a_command_is_refused_and_named_with_its_node(ros, topic, lockstep):
    rivals = Rivals(ros, topic, lockstep)
    forge = rivals.join()
    ros.spin_until(rivals.reader.rivals)
    assert rivals.reader.rivals() == f"{topic.name} has a second publisher: /outsider"
    forge(wire.HeaderTemplate("land").encode(7))
    rivals.send(HEADER.encode(8))
    refusals = rivals.reader.refusals
    ros.spin_until(lambda: rivals.taken and refusals.counts)
    assert [one.stamp_ns for one in rivals.taken] == [8]
    assert refusals.newest == f"{topic.name}: is from a second publisher: /outsider"


def test_forged_states_do_not_push_out_the_true_one_and_are_refused(ros):
    rivals = Rivals(ros, topics.odom(1), decode=wire.decode_odometry)
    forge = rivals.join()
    rivals.send(ODOMETRY.encode(7, np.ones(13)))
    for _ in range(10):  # before the reader has a chance to take one
        forge(ODOMETRY.encode(8, np.ones(13)))
    ros.spin_until(lambda: rivals.reader.refusals.counts["/uav1/odom"] == 10)
    assert [one.stamp_ns for one in rivals.taken] == [7]


def test_a_second_publisher_of_a_long_stream_is_refused_from_its_first_message_on(ros):
    """As long as the first is alone its messages come without GIDs, which costs less."""
    rivals = Rivals(ros, topics.odom(1), decode=wire.decode_odometry)
    (subscription,) = rivals.reader._subscriptions
    while subscription.by_gid:
        sent = len(rivals.taken) + 1
        rivals.send(ODOMETRY.encode(sent, np.ones(13)))
        ros.spin_until(partial(rivals.heard, sent))
    forge = rivals.join()
    for k in range(5):
        forge(ODOMETRY.encode(10**6, np.ones(13)))
        rivals.send(ODOMETRY.encode(sent + k + 1, np.ones(13)))
    refusals = rivals.reader.refusals
    ros.spin_until(lambda: refusals.counts["/uav1/odom"] == 5 and rivals.heard(sent + 5))
    assert [one.stamp_ns for one in rivals.taken] == [*range(1, sent + 6)]
    assert subscription.by_gid


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_process_that_was_started_again_is_heard(ros, lockstep):
    """It has a new GID, and its node the name of the old one."""
    rivals = Rivals(ros, topics.odom(1), lockstep, decode=wire.decode_odometry)
    rivals.send(ODOMETRY.encode(7, np.ones(13)))
    ros.spin_until(lambda: rivals.taken)
    again = rivals.join(Endpoints(ros.node("uav1"), lockstep))

    def heard():
        again(ODOMETRY.encode(8, np.ones(13)))
        return len(rivals.taken) > 1

    ros.spin_until(heard)


def test_all_publishers_of_a_shared_topic_are_heard(ros):
    rivals = Rivals(ros, topics.EMERGENCY)
    rivals.join()(wire.HeaderTemplate("land").encode(7))
    ros.spin_until(lambda: rivals.taken)
    assert rivals.reader.rivals() == ""
    rivals = Rivals(ros, topics.SLOTS)
    rivals.reader.shares(topics.SLOTS)
    rivals.join()(wire.HeaderTemplate("1:1").encode(7))
    ros.spin_until(lambda: rivals.taken)


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
