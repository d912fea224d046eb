"""The services of the leader: legs, words on a mission, seals; called in one process, and by an operator of a fleet."""

import json
import signal
import subprocess
import sys
import time
from datetime import datetime, timezone

import numpy as np
import pytest

pytest.importorskip("rclpy")

from std_srvs.srv import Trigger
from uav_surroundings import FOLLOWER, LEADER, Others, call

from ptnsbc_io import wire
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.seal import KEY_FILE, Seal, new_key, read_key
from ptnsbc_nodes.fleet.fleet_node import FleetNode, LeaderClient
from ptnsbc_nodes.runtime.launcher import PARENT
from ptnsbc_nodes.uav.uav_node import UavNode
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.legs import CANCEL
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.reading.bag_reader import read_recording
from ptnsbc_tools.replay.rerun import rerun

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


MISSION = """
extends: paper_5_free
timing: {duration_s: 120}
security: signed
leader: {trajectory: {kind: hover, position_m: [0, 5, 10]}}
mission:
  cancel_s: 2
  legs:
    - {kind: form, over_s: 5}
    - {kind: go_to, name: gate, position_m: [6, 5, 10], over_s: 80, on: word}
    - {kind: go_to, name: far, position_m: [900, 5, 10], over_s: 4, on: word}
"""


@pytest.mark.slow
def test_an_operator_begins_and_cancels_legs_of_a_sealed_fleet(
    launch, ros, tmp_path, domain, monkeypatch
):
    """A leg that cannot be flown is refused, without a key nothing is heard, and the bag runs again."""
    key = tmp_path / "fleet.key"
    new_key(key)
    monkeypatch.setenv(KEY_FILE, str(key))
    (tmp_path / "mission.yaml").write_text(MISSION)
    words = ("--scenario", str(tmp_path / "mission.yaml"), "--processes", "2", "--wait")
    flight = launch(*words, "--bag", str(tmp_path / "bag"), domain=domain)
    now = [0]
    seal = Seal(read_key(key), required=True)
    ends = Endpoints(ros.node("operator"), lockstep=True, seal=seal)
    ends.listen(topics.odom(1), wire.decode_odometry, lambda one: now.__setitem__(0, one.stamp_ns))

    def mission(*words: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "ptnsbc_tools", "mission", *words]
        return subprocess.run(
            [*command, "--domain", str(domain)], capture_output=True, text=True, timeout=200
        )

    flight.wait_for("all are ready")
    assert now == [0]
    started = mission("start", "1")
    assert started.returncode == 0, started.stderr
    ros.spin_until(lambda: now[0] > 0, timeout=200.0)
    begun = mission("start", "gate")
    assert begun.returncode == 0, begun.stderr
    with FleetNode(domain, "asker", seal=seal) as node:
        leader = LeaderClient(node)
        taken, why, _ = leader.ask("leg_3", 60.0)
        assert not taken
        assert why.startswith("leg far leaves -")
        told = json.loads(leader.ask("mission", 60.0)[1])["legs"]
        assert "begin_s" in told[1], "the refused leg has not ended the one that is flown"
    with FleetNode(domain, "outsider") as node:
        unheard, why, _ = LeaderClient(node).ask("cancel", 60.0)
        assert not unheard
        assert why.startswith("security: signed: expected a sealed")
    cancelled = mission("cancel")
    assert cancelled.returncode == 0, cancelled.stderr
    after: list[int] = []  # stamps since the leader has the word: `cancel_s` is over after 2 s
    ends.listen(topics.odom(1), wire.decode_odometry, lambda one: after.append(one.stamp_ns))
    ros.spin_until(lambda: after and after[-1] > after[0] + 5_000_000_000, timeout=200.0)
    flight.process.send_signal(signal.SIGINT)
    assert flight.finish() == 130, "\n".join(flight.lines)

    recording = read_recording(tmp_path / "bag")
    words = recording.scenario.words
    assert [word.number for word in words] == [2, CANCEL]
    judged = verdict_on(recording)
    assert [(leg.name, leg.verdict) for leg in judged.mission[1:]] == [
        ("gate", "cut short"), ("cancelled", "met"),
    ]  # fmt: skip
    bag = read_bag(tmp_path / "bag")
    scenario = scenario_from_text(bag.attachment("scenario.yaml").decode())
    assert rerun(bag, scenario).verdict == "equal"
    rest_ns = recording.first_ns + round((words[1].at_s + 3.0) * 1e9)
    at = recording.odometry[1].at(np.array([rest_ns, recording.end_ns]), 3)
    assert np.linalg.norm(at[1] - at[0]) < 0.05, "at rest"
    assert at[1, 0] < 5.5, "not at the gate"


def test_leader_serves_the_legs_of_a_lockstep_flight(ros, scenario):
    others = Others(ros, scenario, LEADER)
    early = call(ros, others.node, "hold")
    assert not early.success
    assert "call /formation/start first" in early.message
    too_early = call(ros, others.node, "start")
    assert (too_early.success, too_early.message) == (
        False,
        "the leader waits for /formation/epoch",
    )
    Endpoints(others.node, lockstep=True).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: not others.uav.waiting_for())
    assert call(ros, others.node, "start").success
    ros.spin_until(lambda: others.epochs == [(0, "form")])
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    assert call(ros, others.node, "land").success
    ros.spin_until(lambda: others.epochs == [(0, "form"), (500_000_000, "land")])


def sealed_uav(ros, scenario, uav_id):
    """A UAV of a fleet with a seal, and the ends of a node with the seal and of one without."""
    seal = Seal(bytes(32))
    edges = CommunicationGraph(scenario, FlightOptions(seal=seal))
    uav = UavNode(ros.node("controller", namespace=f"/uav{uav_id}"), scenario, uav_id, edges)
    return uav, Endpoints(ros.node("ours"), False, seal), Endpoints(ros.node("theirs"), False)


def test_with_a_seal_no_leg_of_an_outsider_counts(ros, scenario):
    uav, ours, theirs = sealed_uav(ros, scenario, FOLLOWER)
    leg = wire.HeaderTemplate("form").encode(7)
    true, forged = ours.publisher(topics.EPOCH, 1), theirs.publisher(topics.EPOCH, 1)
    ros.spin_until(lambda: not ours.unread() and not theirs.unread())
    forged(leg)
    ros.spin_until(lambda: uav.endpoints.refusals.counts)
    assert "not sealed with the key of the fleet" in uav.endpoints.refusals.newest
    assert not uav.flight.epochs.announced
    true(leg)
    ros.spin_until(lambda: uav.flight.epochs.announced)
    ros.spin_until(uav.endpoints.rivals)
    assert uav.endpoints.rivals()[0].startswith("/formation/epoch: /")


def test_with_a_seal_the_leader_answers_no_call_without_a_sealed_request(ros, scenario):
    _, ours, theirs = sealed_uav(ros, scenario, LEADER)
    send = [ends.publisher(topics.REQUEST, 1) for ends in (ours, theirs)]
    ros.spin_until(lambda: not ours.unread() and not theirs.unread())
    node = ours._node
    refused = call(ros, node, "stop").message
    assert refused.startswith("security: signed: expected a sealed /formation/request")
    request = wire.HeaderTemplate("stop").encode(0)
    send[1](request)
    ros.spin_for(0.1)
    assert call(ros, node, "stop").message == refused
    send[0](request)
    ros.spin_for(0.1)
    assert call(ros, node, "stop").message == "not started: call /formation/start first"
    assert call(ros, node, "stop").message == refused  # one call for one request


def start(ros, others):
    """Begin the flight by the operator's service, and fly its first tick."""
    Endpoints(others.node, lockstep=True).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: not others.uav.waiting_for())
    assert call(ros, others.node, "start").success
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])


def test_leader_takes_words_on_the_legs_of_a_mission(ros):
    legs = [
        {"kind": "form", "over_s": 5},
        {"kind": "go_to", "name": "gate", "position_m": [2, 5, 6], "over_s": 4, "on": "word"},
        {"kind": "go_to", "name": "far", "position_m": [500, 5, 6], "over_s": 4, "on": "word"},
    ]
    others = Others(ros, load_scenario("paper_5_free", {"mission": {"legs": legs}}), LEADER)
    assert "call /formation/start first" in call(ros, others.node, "cancel").message
    assert call(ros, others.node, "leg_2").message == "the leader waits for /formation/epoch"
    start(ros, others)
    told = json.loads(call(ros, others.node, "mission").message)
    assert told["now_s"] == 0.0
    assert [(leg["name"], leg.get("begin_s")) for leg in told["legs"]] == [
        ("form-1", 0.0), ("gate", None), ("far", None),
    ]  # fmt: skip
    refused = call(ros, others.node, "leg_3")
    assert not refused.success
    assert refused.message.startswith("leg far leaves -")
    taken = call(ros, others.node, "leg_2")
    assert (taken.success, taken.message) == (True, "leg gate from 0.50 s, due at 4.50 s")
    ros.spin_until(lambda: others.epochs == [(0, "form"), (500_000_000, "mission 2")])
    told = json.loads(call(ros, others.node, "mission").message)
    assert told["legs"][1]["begin_s"] == 0.5
    assert call(ros, others.node, "start").message.startswith("begun already")


def test_the_present_leg_is_cancelled(ros):
    legs = [{"kind": "form", "over_s": 5}, {"kind": "go_to", "position_m": [2, 5, 6], "over_s": 9}]
    mission = {"mission": {"legs": legs, "cancel_s": 2}}
    others = Others(ros, load_scenario("paper_5_free", mission), LEADER)
    start(ros, others)
    assert call(ros, others.node, "cancel").success
    ros.spin_until(lambda: len(others.epochs) == 2)


def test_the_leader_of_real_vehicles_begins_when_its_launcher_listens(ros, scenario, monkeypatch):
    """The launcher does so once all vehicles are in the air: an operator may call earlier."""
    monkeypatch.setenv(PARENT, "1")
    graph = CommunicationGraph(scenario, FlightOptions(bridged=True))
    uav = UavNode(ros.node("controller", namespace="/uav1"), scenario, LEADER, graph)
    operator, launcher = ros.node("operator"), ros.node(topics.LAUNCHER)
    assert call(ros, operator, "start").message.startswith("not all processes and vehicles")
    Endpoints(launcher, lockstep=False).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: uav.endpoints.is_heard_by(topics.EPOCH, topics.LAUNCHER))
    assert call(ros, operator, "start").message.startswith("the leader waits for")


def test_a_fleet_that_waits_begins_with_the_formation_and_goes_on_with_a_later_leg(ros):
    """As after an abort, when it has taken off again."""
    legs = [
        {"kind": "form", "over_s": 8, "stay_s": 1},
        {"kind": "go_to", "name": "gate", "position_m": [2, 5, 6], "over_s": 40},
        {"kind": "go_to", "name": "back", "position_m": [0, 5, 6], "over_s": 10},
        {"kind": "go_to", "name": "far", "position_m": [500, 5, 6], "over_s": 4, "on": "word"},
    ]
    others = Others(ros, load_scenario("paper_5_free", {"mission": {"legs": legs}}), LEADER)
    Endpoints(others.node, lockstep=True).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: not others.uav.waiting_for())
    told = json.loads(call(ros, others.node, "mission").message)
    assert told["now_s"] is None and told["legs"][2]["begin_s"] == 49.0
    refused = call(ros, others.node, "leg_4")
    assert refused.message.startswith("leg far leaves -")
    assert not others.uav.flight.epochs.announced
    begun = call(ros, others.node, "leg_3")
    assert begun.message == "leg back from 9.00 s, due at 19.00 s"
    ros.spin_until(lambda: others.epochs == [(0, "form"), (9_000_000_000, "mission 3")])


def test_a_mission_that_should_have_begun_is_not_started(ros):
    """In real time; one that is to begin later begins at that very instant, one of every hour at the next."""
    legs = [{"kind": "form", "over_s": 5}]
    soon_s = round(time.time()) + 60

    def text(start_s):
        return datetime.fromtimestamp(start_s, timezone.utc).isoformat().replace("+00:00", "Z")

    hourly = "*" + text(soon_s)[13:]
    cases = (
        (text(soon_s - 120), False),
        (text(soon_s + 7200), False),
        (text(soon_s), True),
        (hourly, True),
    )
    for start, begins in cases:
        mission = {"mission": {"start": start, "legs": legs}}
        others = Others(ros, load_scenario("paper_5_free", mission), LEADER, lockstep=False)
        others.fly(ros)
        answer = call(ros, others.node, "start")
        assert answer.success == begins
        if begins:
            ros.spin_until(lambda others=others: others.epochs)
            assert others.epochs[0].stamp_ns == soon_s * 1_000_000_000
        else:
            assert "expected a time within the next 3600 s" in answer.message
        for node in (others.node, others.uav.node):
            ros.remove(node)


def test_who_leads_next_tells_the_legs_again(ros):
    """A UAV that is started after the leader's process has ended hears of the epoch from its successor."""
    relay = load_scenario("relay")
    others = Others(ros, relay, 2, lockstep=False)
    heard = []
    listener = Endpoints(ros.node("listener"), lockstep=False)
    listener.shared.add(topics.EPOCH.name)
    listener.listen(topics.EPOCH, wire.decode_header, heard.append)
    epoch = wire.HeaderFields(time.time_ns(), "form")
    others.form(*epoch)

    def flown(*absent):
        others.odom(time.time_ns())
        others.neighbours(time.time_ns(), without=absent)

    def all_there():
        flown()
        return heard and others.newest()[2]["mode"] == "form"

    ros.spin_until(all_there)
    ros.spin_until(lambda: flown() or time.time_ns() > epoch.stamp_ns + 1_000_000_000)
    assert heard == [epoch]
    ros.spin_until(lambda: flown(1) or len(heard) == 2)
    assert heard == [epoch, epoch]
    assert "second publisher" not in others.newest()[1]
    assert call(ros, others.node, "hold").success
    ros.spin_until(lambda: flown(1) or others.newest()[2]["mode"] == "hold")
    assert [leg.frame_id for leg in heard] == ["form", "form", "hold"]


def test_a_leader_that_comes_back_serves_no_longer(ros):
    """Its successor does: a UAV that was away does not lead again."""
    others = Others(ros, load_scenario("relay"), LEADER, lockstep=False)
    hold = others.node.create_client(Trigger, "/formation/hold")
    ros.spin_until(hold.service_is_ready)
    told = Endpoints(ros.node("successor"), lockstep=False).publisher(topics.EPOCH, 1)
    told(wire.HeaderTemplate("form").encode(time.time_ns() - 10_000_000_000))

    def flown():
        others.odom(time.time_ns())
        others.neighbours(time.time_ns())

    ros.spin_until(lambda: flown() or not hold.service_is_ready())
