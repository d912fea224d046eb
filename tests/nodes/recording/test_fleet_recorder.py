"""The recorder inside a process and as a process of its own."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.duration import Duration

from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, BagWriter, read_bag
from ptnsbc_nodes.comm import qos, topics
from ptnsbc_nodes.comm.agent_messages import Transforms
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.recording.fleet_recorder import (
    Completeness,
    LockstepRecorder,
    PendingMessage,
    RealTimeRecorder,
    ReorderBuffer,
)
from ptnsbc_nodes.recording.recorder import BagRecorder, stamp_of, topic_info
from ptnsbc_nodes.recording.recorder_main import main

ROOT = Path(__file__).parents[3]
TICK_NS = 10_000_000
ODOM = wire.OdometryTemplate("map", "uav1")
VELOCITY = wire.VelocityTemplate("map")
RECORDED = topics.recorded([1])


def messages(ticks: int) -> dict[topics.Topic, list[bytes]]:
    """A short flight of UAV 1, by topic."""
    stamps = [k * TICK_NS for k in range(ticks)]
    return {
        topics.odom(1): [ODOM.encode(s, np.full(13, s)) for s in stamps],
        topics.near(1): [wire.encode_near(s, "map", np.ones((2, 8))) for s in stamps],
        topics.velocity_setpoint(1): [VELOCITY.encode(s, np.ones(6)) for s in stamps],
        topics.CLOCK: [wire.encode_clock(s) for s in stamps],
        topics.EPOCH: [wire.HeaderTemplate("leg 1").encode(3 * TICK_NS)],
    }


class Flight:
    """Publishers that match the recorder, a node of ours or a process, before the first message."""

    def __init__(self, ros, recorded, *, lockstep: bool, recorder=None) -> None:
        self.node = node = ros.node("uav")
        self._publishers = {
            topic: node.create_publisher(
                topics.message_class(topic), topic.name, qos.profile(topic, lockstep=lockstep)
            )
            for topic in sorted(recorded, key=topics.EPOCH.__eq__)
        }
        ros.spin_until(lambda: all(p.get_subscription_count() for p in self._publishers.values()))
        names = {topic.name for topic in recorded}
        ends = (
            [end for end in recorder.subscriptions if end.topic_name in names] if recorder else []
        )
        ros.spin_until(lambda: all(end.get_publisher_count() for end in ends))

    def publish(self, topic, data: bytes) -> None:
        self._publishers[topic].publish(data)

    def publish_paced(self, order) -> None:
        """The epoch first: its publisher was announced last, so who acknowledges the epoch knows all of them."""
        for topic, data in sorted(order, key=lambda message: message[0] != topics.EPOCH):
            self.publish(topic, data)
            if topic == topics.EPOCH:
                assert self._publishers[topic].wait_for_all_acked(Duration(seconds=60))
            # As a fleet does: best effort holds no message back for a reader that is not so quick.
            time.sleep(0.002)


def record(ros, path: Path, lockstep: bool, order, recorded=RECORDED) -> BagRecorder:
    """Publish `order`, a list of (topic, bytes), and record it."""
    infos = [topic_info(topic, lockstep=lockstep) for topic in topics.in_bag([1])]
    with BagWriter(path, infos) as writer:
        node = ros.node("recorder")
        kind = LockstepRecorder if lockstep else RealTimeRecorder
        recorder = kind(node, writer, recorded, Transforms([1]))
        flight = Flight(ros, messages(1), lockstep=lockstep, recorder=node)
        for count, (topic, data) in enumerate(order, start=1):
            flight.publish(topic, data)
            if count % 5 == 0:
                ros.spin_until(lambda c=count: recorder.received >= c)
        ros.spin_until(lambda: recorder.received == len(order))
        recorder.finish()
    ros.remove(node)
    ros.remove(flight.node)
    return recorder


def mixed(seed: int, ticks: int = 40, **late: int) -> list[tuple[topics.Topic, bytes]]:
    """The flight, each topic in order, the topics mixed up to 10 ticks apart; `late`: of topics, by their last word."""
    rng = random.Random(seed)
    lag = {
        topic: late.get(topic.name.rpartition("/")[2], rng.randrange(10)) for topic in messages(1)
    }
    keyed = [
        (tick + lag[topic], i, topic, data)
        for i, (topic, datas) in enumerate(messages(ticks).items())
        for tick, data in enumerate(datas)
    ]
    return [(topic, data) for *_, topic, data in sorted(keyed, key=lambda m: m[:2])]


@pytest.mark.parametrize("late", [{}, {"odom": 30}, {"epoch": 35}])
def test_lockstep_gives_the_same_bytes(ros, tmp_path, late):
    """Also where a topic comes thirty ticks behind all others: a transform came too late to be sorted in."""
    contents = set()
    for seed in (1, 2, 3) if not late else (1,):
        path = tmp_path / str(seed) / "flight"
        # In the second kind of flight all that is recorded is sent: what is complete is written at once.
        recorder = record(ros, path, True, mixed(seed, **late), messages(1) if late else RECORDED)
        assert recorder.late == 0
        contents.add((path / "flight_0.mcap").read_bytes())
        contents.add((path / "metadata.yaml").read_bytes())
    assert len(contents) == 2
    if late:
        record(ros, tmp_path / "again" / "flight", True, mixed(2))
        assert (tmp_path / "again" / "flight" / "flight_0.mcap").read_bytes() in contents
    got = list(read_bag(path).messages())
    assert [m.stamp_ns for m in got if m.topic == "/uav1/odom"] == [k * TICK_NS for k in range(40)]
    assert [m.stamp_ns for m in got if m.topic == "/formation/epoch"] == [3 * TICK_NS]
    assert [m.stamp_ns for m in got if m.topic == "/tf"] == [k * 5 * TICK_NS for k in range(8)]
    keys = [(m.stamp_ns, m.topic) for m in got]
    assert keys == sorted(keys)


def test_lockstep_writes_the_first_instant_as_soon_as_it_is_whole(ros, tmp_path):
    """A recorder that was killed in the first twenty ticks left a bag without a message."""
    odom, clock = topics.odom(1), topics.CLOCK
    recorded = (odom, clock, topics.EPOCH)
    infos = [topic_info(topic, lockstep=True) for topic in (*recorded, topics.TF)]
    with BagWriter(tmp_path / "flight", infos) as writer:
        node = ros.node("recorder")
        recorder = LockstepRecorder(node, writer, recorded, Transforms([1]))
        flight = Flight(ros, recorded, lockstep=True, recorder=node)
        first = [(topic, sent[0]) for topic, sent in messages(1).items() if topic in recorded]
        for count, (topic, data) in enumerate(first, start=1):
            assert readable(tmp_path / "flight.part") == 0
            flight.publish(topic, data)
            ros.spin_until(lambda n=count: recorder.received == n)
        assert readable(tmp_path / "flight.part") == len({odom, clock, topics.TF})
        recorder.finish()


def test_lockstep_gives_the_same_bytes_whenever_a_leg_is_announced(ros, tmp_path):
    """Before the first instant, among the ticks that are sorted, and after the first instant is written without it."""
    leg = (topics.EPOCH, wire.HeaderTemplate("leg 1").encode(38 * TICK_NS))
    rest = [
        (topic, sent[k])
        for k in range(40)
        for topic, sent in messages(40).items()
        if topic != topics.EPOCH
    ]
    contents = set()
    for at in (0, 20, 120):
        path = tmp_path / str(at) / "flight"
        assert record(ros, path, True, [*rest[:at], leg, *rest[at:]], messages(1)).late == 0
        contents.add((path / "flight_0.mcap").read_bytes())
    assert len(contents) == 1


def test_messages_that_a_full_queue_drops_are_counted(ros, tmp_path):
    """Those that waited in it are logged when they arrived, not when they were taken out."""
    odom = topics.odom(1)
    depth = qos.recorder_profile(odom, lockstep=False).depth
    sent = messages(depth + 31)[odom]
    infos = [topic_info(topic, lockstep=False) for topic in (odom, topics.TF)]
    with BagWriter(tmp_path / "flight", infos) as writer:
        node = ros.node("recorder")
        recorder = RealTimeRecorder(node, writer, [odom], Transforms([1]))
        flight = Flight(ros, [odom], lockstep=False, recorder=node)
        flight.publish(odom, sent[0])
        ros.spin_until(lambda: recorder.received == 1)
        assert recorder.lost == 0
        flight.publish_paced((odom, data) for data in sent[1:])
        published_ns = time.time_ns()
        ros.spin_until(lambda: recorder.received == 1 + depth)
        recorder.finish()
    assert recorder.lost == 30
    arrived = [message.stamp_ns for message in read_bag(tmp_path / "flight").messages([odom.name])]
    assert arrived == sorted(arrived)
    assert arrived[depth // 2] < published_ns


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_damaged_status_is_not_recorded_and_is_named(ros, tmp_path, lockstep):
    """One of them made a bag that no command would read."""
    recorded = (topics.odom(1), topics.DIAGNOSTICS)
    sound = diagnostics(0, "uav1: planner", DiagnosticLevel.OK, "", {"ready": "true"})
    infos = [topic_info(topic, lockstep=lockstep) for topic in (*recorded, topics.TF)]
    with BagWriter(tmp_path / "flight", infos) as writer:
        node = ros.node("recorder")
        kind = LockstepRecorder if lockstep else RealTimeRecorder
        recorder = kind(node, writer, recorded, Transforms([1]))
        flight = Flight(ros, recorded, lockstep=lockstep, recorder=node)
        for data in (sound[:-9], sound, sound[:40]):
            flight.publish(topics.DIAGNOSTICS, data)
        ros.spin_until(lambda: recorder.received == 1 and recorder.refusals.counts.total() == 2)
        recorder.finish()
    bag = read_bag(tmp_path / "flight")
    assert [message.data for message in bag.messages(["/diagnostics"])] == [sound]
    assert recorder.refusals.report().startswith("2 messages refused: /diagnostics: ")


def test_the_sim_is_told_of_what_all_topics_have(ros, tmp_path):
    """A topic whose messages come late held nothing back once, and the queues of a recorder lost messages."""
    odom, velocity, clock = topics.odom(1), topics.velocity_setpoint(1), topics.CLOCK
    recorded = (odom, velocity, clock)
    sent, told = messages(60), []
    with BagWriter(
        tmp_path / "flight", [topic_info(t, lockstep=True) for t in (*recorded, topics.TF)]
    ) as writer:
        node = ros.node("recorder")
        recorder = LockstepRecorder(node, writer, recorded, Transforms([1]))
        sim = Endpoints(ros.node("sim"), lockstep=True)
        sim.listen(topics.RECORDED, wire.decode_header, told.append)
        lost = sim.publisher(topics.LOST, 1)
        flight = Flight(ros, recorded, lockstep=True, recorder=node)
        ros.spin_until(lambda: not sim.unheard() and not sim.unread())
        for tick in range(60):
            flight.publish(odom, sent[odom][tick])
            flight.publish(clock, sent[clock][tick])
            ros.spin_until(lambda n=2 * (tick + 1): recorder.received == n)
        ros.spin_for(0.1)
        assert told == []
        for tick in range(30):
            flight.publish(velocity, sent[velocity][tick])
            ros.spin_until(lambda n=121 + tick: recorder.received == n)
        ros.spin_until(lambda: len(told) == 2)
        assert 20 * TICK_NS < told[-1].stamp_ns <= 30 * TICK_NS
        lost(wire.HeaderTemplate("uav1").encode(0))
        ros.spin_until(lambda: recorder._completeness.complete_ns > 59 * TICK_NS)
        recorder.finish()
        assert recorder.late == 0


def test_the_sim_is_told_when_what_comes_seldom_comes_last(ros, tmp_path):
    """Each of its messages completes several ticks. Counted as one, the word came too late, and the sim waited."""
    odom, near, clock = recorded = topics.odom(1), topics.near(1), topics.CLOCK
    sent, told, every = messages(60), [], 10
    infos = [topic_info(topic, lockstep=True) for topic in (*recorded, topics.TF)]
    with BagWriter(tmp_path / "flight", infos) as writer:
        node = ros.node("recorder")
        recorder = LockstepRecorder(node, writer, recorded, Transforms([1]))
        sim = Endpoints(ros.node("sim"), lockstep=True)
        sim.listen(topics.RECORDED, wire.decode_header, told.append)
        flight = Flight(ros, recorded, lockstep=True, recorder=node)
        ros.spin_until(lambda: not sim.unheard())
        for tick in range(60):
            flight.publish(odom, sent[odom][tick])
            flight.publish(clock, sent[clock][tick])
            ros.spin_until(lambda n=2 * (tick + 1): recorder.received == n)
        for count, tick in enumerate(range(0, 60, every), start=1):
            flight.publish(near, sent[near][tick])
            ros.spin_until(lambda n=120 + count: recorder.received == n)
        ros.spin_until(lambda: len(told) == 4)
        recorder.finish()
    assert [word.stamp_ns // TICK_NS for word in told] == [19, 29, 39, 49]


def test_real_time(ros, tmp_path):
    before = time.time_ns()
    order = mixed(1, ticks=10)
    record(ros, tmp_path / "flight", False, order)
    bag = read_bag(tmp_path / "flight")
    got = list(bag.messages())
    sent = [m.data for m in got if m.topic != "/tf"]
    assert sorted(sent) == sorted(data for _, data in order)
    assert len(got) - len(sent) == 2  # 10 ticks are two periods of /tf
    assert all(before <= m.stamp_ns <= time.time_ns() for m in got)


def test_real_time_keeps_the_publish_time(ros, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    record(ros, tmp_path / "flight", False, mixed(1, ticks=10))
    with (tmp_path / "flight" / "flight_0.mcap").open("rb") as stream:
        for _, _, message in reader.make_reader(stream).iter_messages(topics=["/uav1/odom"]):
            assert message.publish_time == wire.peek_stamp(message.data)


def test_quality_of_service_is_that_of_the_publishers():
    def offered(topic: topics.Topic, lockstep: bool) -> tuple[str, str, int]:
        (one,) = topic_info(topic, lockstep=lockstep).qos
        return one["reliability"], one["durability"], one["depth"]

    odom = topics.odom(1)
    assert offered(odom, lockstep=False) == ("best_effort", "volatile", 1)
    assert offered(odom, lockstep=True) == ("reliable", "volatile", 10)
    assert offered(topics.EPOCH, lockstep=False) == ("reliable", "transient_local", 1)


def test_stamps():
    assert stamp_of(topics.odom(1), ODOM.encode(5, np.ones(13))) == 5
    assert stamp_of(topics.CLOCK, wire.encode_clock(6)) == 6
    assert stamp_of(topics.MARKERS, b"\0\1\0\0" + bytes(4)) is None
    tf = b"\0\1\0\0\1\0\0\0" + wire.HeaderTemplate("map").encode(7)[4:]
    assert stamp_of(topics.TF, tf) == 7
    assert stamp_of(topics.odom(1), b"rubbish") is None
    assert stamp_of(topics.odom(1), ODOM.encode(-1, np.ones(13))) is None


class Process:
    """The recorder as launch starts it."""

    def __init__(self, domain: int, *arguments: str) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "ptnsbc_nodes.recording.recorder_main", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        )

    def wait_ready(self) -> None:
        assert self.popen.stderr is not None
        while (line := self.popen.stderr.readline()) != "ready\n":
            assert line, "the recorder ended before it was ready"

    def end(self, how: signal.Signals) -> tuple[int, str, str]:
        self.popen.send_signal(how)
        out, err = self.popen.communicate(timeout=60)
        return self.popen.returncode, out, err


@pytest.mark.ros
@pytest.mark.parametrize(("how", "lockstep"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_process(ros, tmp_path, how, lockstep):
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text("n: 1\n")
    process = Process(
        ros.domain, "--bag", str(tmp_path / "flight"), "--uavs", "1",
        "--attach", f"scenario.yaml={scenario}", "--meta", "seed=7",
        *(["--lockstep"] if lockstep else []),
    )  # fmt: skip
    process.wait_ready()
    flight = Flight(ros, messages(1), lockstep=lockstep)
    order = mixed(1, ticks=10)
    flight.publish_paced(order)
    # At once: what is under way must still get in.
    code, out, err = process.end(how)
    assert code == 0, err
    (line,) = out.splitlines()
    report = json.loads(line)
    assert report["bag"] == str(tmp_path / "flight")
    assert report["messages"] == len(order) + 2 == sum(report["topics"].values())
    assert report["topics"]["/tf"] == 2
    assert report["topics"]["/uav1/odom"] == 10
    assert (report["late"], report["lost"]) == (0, 0)
    bag = read_bag(tmp_path / "flight")
    assert bag.metadata == {"seed": "7"}
    assert bag.attachment("scenario.yaml") == b"n: 1\n"
    assert len(list(bag.messages())) == len(order) + 2


def readable(part: Path) -> int:
    """Messages that a recording which is not complete has on disk."""
    try:
        return len(list(read_bag(part, salvage=True).messages()))
    except BagError:  # no message yet
        return 0


@pytest.mark.ros
def test_killed_process_keeps_what_was_flushed(ros, tmp_path):
    process = Process(ros.domain, "--bag", str(tmp_path / "flight"), "--uavs", "1")
    process.wait_ready()
    flight = Flight(ros, messages(1), lockstep=False)
    flight.publish_paced(mixed(1, ticks=10))
    ros.spin_until(lambda: readable(tmp_path / "flight.part") == 41 + 2)  # and /tf
    process.end(signal.SIGKILL)
    assert readable(tmp_path / "flight.part") == 41 + 2


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([], "exists: choose another name, or overwrite it"),
        (["--attach", "a=/no/such/file"], "--attach a=/no/such/file: No such file"),
    ],
)
def test_errors_in_words(tmp_path, capfd, more, message):
    old = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if not more:
        (tmp_path / "flight").mkdir()
    assert main(["--bag", str(tmp_path / "flight"), "--uavs", "1", *more]) == 1
    for number, handler in old.items():
        signal.signal(number, handler)
    captured = capfd.readouterr()
    assert message in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("text", ["name", "=value"])
def test_wrong_pair(text, capfd):
    with pytest.raises(SystemExit):
        main(["--bag", "x", "--uavs", "1", "--meta", text])
    assert "expected name=value" in capfd.readouterr().err


PERIODS = {"/a": 1, "/b": 1, "/c": 5, "/d": 20}


def test_nothing_is_complete_before_every_source_was_heard():
    received = Completeness(["/a", "/b"])
    assert not received.add("/a", 0)
    assert not received.add("/a", 1)
    assert received.add("/b", 0)
    assert received.complete_ns == 0


def test_a_rare_source_is_complete_up_to_its_next_message():
    received = Completeness(["/a", "/c"])
    for stamp in range(11):
        received.add("/a", stamp)
        if stamp % 5 == 0:
            received.add("/c", stamp)
    assert received.complete_ns == 10
    for stamp in range(11, 20):
        received.add("/a", stamp)
    assert received.complete_ns == 14  # the message of 15 is missing


def test_a_silence_is_not_taken_for_the_time_between_two_messages():
    received = Completeness(["/a", "/d"], {"/d": [(10, 60)]})
    for stamp in range(70):
        received.add("/a", stamp)
    received.add("/d", 0)
    received.add("/d", 60)
    assert received.complete_ns == 60
    received.add("/d", 65)
    assert received.complete_ns == 69


def test_what_is_complete_has_arrived():
    """Each source in order, the sources up to 60 stamps apart: nothing comes at or below `complete_ns` any more."""
    for seed in range(30):
        draw = random.Random(seed)
        lag = {name: draw.randrange(60) for name in PERIODS}
        sent = [(stamp, name) for name, every in PERIODS.items() for stamp in range(0, 300, every)]
        received, left = Completeness(PERIODS), sorted(sent)
        for stamp, name in sorted(sent, key=lambda one: (one[0] + lag[one[1]], one[1])):
            assert stamp > received.complete_ns
            received.add(name, stamp)
            left.remove((stamp, name))
            assert all(other > received.complete_ns for other, _ in left)
        assert received.complete_ns >= 295


def test_a_lost_source_holds_nothing_back():
    received = Completeness(["/a", "/b"])
    for stamp in range(5):
        received.add("/a", stamp)
    assert received.complete_ns == -1
    assert received.lose("/b")
    assert received.complete_ns == 4
    assert not received.lose("/b")
    assert not received.add("/b", 9)
    assert received.add("/a", 5)


def test_a_source_that_is_not_awaited_changes_nothing():
    received = Completeness(["/a"])
    assert not received.add("/x", 3)
    assert received.complete_ns == -1


SORTED = ("/a", "/b", "/shared")


def sent_in_order(ticks: int) -> list[tuple[int, str, bytes]]:
    return [
        (tick, topic, f"{topic}{tick}{part}".encode())
        for tick in range(ticks)
        for topic in SORTED
        for part in range(2)
    ]


def sorted_as_they_come(messages) -> tuple[list[tuple[int, str, bytes]], int]:
    order = ReorderBuffer(frozenset({"/shared"}))
    out: list[PendingMessage] = []
    for message in messages:
        order.push(*message)
        out += order.release(keep=20)
    out += order.release()
    return [(held.stamp_ns, held.topic, held.data) for held in out], order.late


def shuffled(messages, seed: int, window: int):
    """Order within a single-publisher topic kept; across topics up to `window` ticks apart."""
    rng = random.Random(seed)
    lag = {topic: rng.randrange(window) for topic in SORTED}

    def key(item):
        position, (tick, topic, _) = item
        chance = rng.random() if topic == "/shared" else 0.0
        return (tick + lag[topic], rng.random() * 0 + SORTED.index(topic), chance, position)

    return [message for _, message in sorted(enumerate(messages), key=key)]


@pytest.mark.parametrize("seed", range(20))
def test_same_out_whatever_in(seed):
    messages = sent_in_order(100)
    assert sorted_as_they_come(shuffled(messages, seed, 20)) == (messages, 0)


def test_arrival_order_is_kept_within_a_topic():
    messages = [(5, "/a", b"z"), (5, "/a", b"a")]
    assert sorted_as_they_come(messages)[0] == messages


def test_shared_topic_is_ordered_by_content():
    assert sorted_as_they_come([(5, "/shared", b"z"), (5, "/shared", b"a")])[0] == [
        (5, "/shared", b"a"),
        (5, "/shared", b"z"),
    ]


def test_a_stamp_far_ahead_pushes_nothing_out():
    out, late = sorted_as_they_come([(10**9, "/a", b""), *sent_in_order(10)])
    assert late == 0
    assert out == [*sent_in_order(10), (10**9, "/a", b"")]


def test_late_messages_are_kept_and_counted():
    out, late = sorted_as_they_come([(k, "/a", b"") for k in range(30)] + [(0, "/b", b"late")])
    assert late == 1
    assert (0, "/b", b"late") in out


def test_a_stamp_waits_for_no_later_one_where_it_is_complete():
    order = ReorderBuffer()
    for message in ((2, "/a", b""), (0, "/b", b""), (1, "/a", b""), (0, "/a", b"")):
        order.push(*message)
        assert not order.release(-1)
    assert [(held.stamp_ns, held.topic) for held in order.release(0)] == [(0, "/a"), (0, "/b")]
    assert [held.stamp_ns for held in order.release()] == [1, 2]
    assert order.late == 0
