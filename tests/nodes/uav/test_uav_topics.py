"""What a UAV hears: neighbours that are lost or send numbers that are none, and setpoints of a user's program."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rclpy")

from uav_surroundings import FOLLOWER, LEADER, PARENT, Others, body

from ptnsbc_io import wire
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import UavFlight, step_time
from ptnsbc_nodes.uav.uav_topics import Outbox
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_tools.reading.bag_reader import read_recording
from ptnsbc_tools.replay.rerun import rerun

pytestmark = pytest.mark.ros

STREAM = """
extends: paper_5_free
timing: {duration_s: 16}
leader:
  trajectory:
    kind: stream
    position_m: [0, 0, 4]
    low_m: [-8, -8, 2]
    high_m: [8, 8, 8]
    speed_m_s: 1.5
    acceleration_m_s2: 1.2
"""


def odometry(place):
    found = np.zeros(13)
    found[:3], found[6] = place, 1.0
    return found


class CountedEndpoints:
    """The messages sent on each topic, and a number of readers that the test sets."""

    fleet = ""

    def __init__(self):
        self.sent, self.read = Counter(), Counter()

    def publisher(self, topic, _readers):
        return lambda _data: self.sent.update([topic.name])

    def readers(self, topic):
        return lambda: self.read[topic.name]


def test_what_nobody_reads_is_not_sent_and_a_late_reader_gets_the_next(scenario):
    """In real time a bridge reads the velocity, and a recorder the log."""
    ends, edges = CountedEndpoints(), CommunicationGraph(scenario, FlightOptions())
    flight = UavFlight(scenario, FOLLOWER, edges)
    outbox = Outbox(ends, edges, flight)
    optional = [
        topics.velocity_setpoint(FOLLOWER),
        topics.tick(FOLLOWER),
        topics.snapshot(FOLLOWER),
    ]
    steps = scenario.timing.control_hz
    for tick in range(2 * steps + 1):
        if tick == steps:
            ends.read.update(topic.name for topic in optional)
        stamp_ns = tick * scenario.timing.dt_ns
        flight.take_odometry(wire.Stamped(stamp_ns, body(FOLLOWER)))
        at = step_time(stamp_ns, scenario.timing.dt_ns, None, 0)
        outbox.send(flight.step(at, NO_CUTOFF_NS))
    assert ends.sent[topics.wrench_setpoint(FOLLOWER).name] == 2 * steps + 1
    assert [ends.sent[topic.name] for topic in optional] == [steps + 1, steps + 1, 2]


@pytest.mark.slow
def test_the_leader_of_a_fleet_follows_setpoints_and_the_bag_runs_again(
    launch, ros, tmp_path, domain
):
    """In lock-step; what cannot be followed is refused, and the silent stream ends in a hover."""
    (tmp_path / "stream.yaml").write_text(STREAM)
    bag_path = tmp_path / "bag"
    words = ("--scenario", str(tmp_path / "stream.yaml"), "--processes", "2")
    flight = launch(*words, "--bag", str(bag_path), domain=domain)
    node = ros.node("user")
    ends = Endpoints(node, lockstep=True)
    heard, now = [], [0]
    ends.listen(topics.TAKEN, wire.decode_odometry, heard.append)
    ends.listen(topics.odom(1), wire.decode_odometry, lambda one: now.__setitem__(0, one.stamp_ns))
    send = ends.publisher(topics.SETPOINT, 1)
    world = wire.OdometryTemplate("map", "map")
    ros.spin_until(lambda: now[0] > 6_000_000_000, timeout=200.0)
    sent_ns = 0

    def tell():
        nonlocal sent_ns
        if now[0] >= sent_ns + 100_000_000:
            sent_ns = now[0]
            send(world.encode(sent_ns, odometry((3.0, -2.0, 5.0))))
            send(world.encode(sent_ns + 1, odometry((30.0, -2.0, 5.0))))  # outside of the region
        return now[0] > 11_000_000_000

    ros.spin_until(tell, timeout=200.0)
    assert flight.finish() == 0, "\n".join(flight.lines)
    recording = read_recording(bag_path)
    taken = recording.scenario.leader.trajectory.setpoints
    assert len(taken) >= 10
    assert {one.position for one in taken} == {(3.0, -2.0, 5.0)}
    assert all(b.at_s >= a.at_s for a, b in pairwise(taken))
    last = recording.odometry[1].at(np.array([recording.end_ns]), 3)[0]
    assert np.linalg.norm(last - [0, 0, 4]) > 1.0, "the leader has gone where it was told"
    bag = read_bag(bag_path)
    scenario = scenario_from_text(bag.attachment("scenario.yaml").decode())
    assert rerun(bag, scenario).verdict == "equal"
    said = " ".join(
        value
        for message in bag.messages(["/diagnostics"])
        for status in wire.decode_diagnostics(message.data).statuses
        for key, value in status.values.items()
        if key == "refused_newest"
    )
    assert "expected one from low_m to high_m" in said


def test_setpoints_before_the_flight_and_of_other_frames_are_refused():
    from ptnsbc_nodes.comm.legs import EpochError, Epochs

    live = {
        "kind": "stream",
        "position_m": [0, 0, 4],
        "low_m": [-8, -8, 2],
        "high_m": [8, 8, 8],
        "speed_m_s": 1,
        "acceleration_m_s2": 1,
    }
    epochs = Epochs(load_scenario("paper_5_free", {"leader.trajectory": live}))
    with pytest.raises(EpochError, match="while the formation is flown"):
        epochs.following(10, odometry((0, 0, 4)))
    epochs.announce(1_000_000_000, "form")
    epochs.take(wire.Stamped(2_000_000_000, odometry((1, 0, 4))))
    before = epochs.scenario
    epochs.take(wire.Stamped(3_000_000_000, odometry((np.nan, 0, 4))))
    assert epochs.scenario is before
    epochs.announce(3_000_000_000, "hold")
    with pytest.raises(EpochError):
        epochs.following(3_500_000_000, odometry((0, 0, 4)))


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


def test_lockstep_goes_on_without_a_lost_neighbour(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    others.odom(scenario.timing.dt_ns)
    others.neighbours(0, without=(PARENT,))
    others.settle()
    assert others.ticks() == [0]
    others.lose(wire.HeaderTemplate(f"uav{PARENT}").encode(0))
    ros.spin_until(lambda: others.ticks() == [0, 1])


BROKEN = {
    "nan": np.nan,
    "inf": np.inf,
    "huge": 1e308,
}


@pytest.mark.parametrize("value", BROKEN.values(), ids=BROKEN)
def test_a_broken_state_of_a_neighbour_is_dropped_and_named(ros, scenario, value):
    """One such number once poisoned a follower for the rest of its flight, in silence."""
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    values = body(LEADER)
    values[0] = value
    template = wire.OdometryTemplate("map", f"uav{LEADER}/base_link")
    others.send_state[LEADER](template.encode(0, values))
    others.odom(scenario.timing.dt_ns)
    others.neighbours(0)
    ros.spin_until(lambda: others.ticks() == [0, 1])
    assert np.isfinite(others.wrenches[-1].values).all()
    # The status after the refusal warns, those after it only count.
    ros.spin_until(lambda: any(told.get("refused") for _, _, told in others.status))
    level, message, told = next(one for one in others.status if one[2].get("refused"))
    assert (level, told["refused"]) == (b"\x01", f"/uav{LEADER}/formation_state=1")
    assert "1 messages refused: /uav1/formation_state: nav_msgs/Odometry: position" in message
