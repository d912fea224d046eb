"""The status of a UAV node: what it waits for, that it holds, and that its vehicle is gone."""

import time

import pytest

pytest.importorskip("rclpy")

from uav_surroundings import FOLLOWER, LEADER, NEIGHBOURS, PARENT, Others, call

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import SafetyState, assess
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.uav_node import PlannerSight, UavNode, planner_concerns
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


def test_lockstep_says_what_it_waits_for(ros, scenario):
    uav = UavNode(
        ros.node("controller"),
        scenario,
        FOLLOWER,
        CommunicationGraph(scenario, FlightOptions(lockstep=True)),
    )
    missing = uav.waiting_for()
    assert f"/uav{FOLLOWER}/odom" in missing
    assert f"/uav{PARENT}/formation_state" in missing
    assert f"/uav{FOLLOWER}/setpoint/wrench" in missing
    # Nobody but the recorder reads it, and there is none.
    assert f"/uav{FOLLOWER}/setpoint/velocity" not in missing
    # Not an edge of the tree.
    assert "/uav5/formation_state" not in missing


def test_real_time_waits_for_its_recorder_before_the_flight_and_not_in_it(ros, scenario):
    """What is to be recorded must be heard from the first step on; a recorder that dies stops nobody."""
    edges = CommunicationGraph(scenario, FlightOptions(recorded=True))
    uav = UavNode(ros.node("controller"), scenario, FOLLOWER, edges)
    uav.start()
    said = {topics.tick(FOLLOWER).name, topics.snapshot(FOLLOWER).name}
    assert said <= set(uav.waiting_for())
    assert topics.wrench_setpoint(FOLLOWER).name in uav.waiting_for()
    leader = Endpoints(ros.node("leader"), False).publisher(topics.EPOCH, 1)
    ros.spin_until(lambda: topics.EPOCH.name not in uav.waiting_for())
    leader(wire.HeaderTemplate("form").encode(time.time_ns() + 10**12))
    ros.spin_until(lambda: not said & set(uav.waiting_for()))


@pytest.mark.parametrize("lockstep", [False, True])
def test_in_real_time_the_last_word_is_a_status(ros, sent, scenario, lockstep):
    """The readers of states that nobody acknowledges have them once they have it."""
    edges = CommunicationGraph(scenario, FlightOptions(lockstep=lockstep))
    ends = UavNode(ros.node("controller"), scenario, FOLLOWER, edges).endpoints
    sent.clear()
    ends.last_word()
    assert sent == ({} if lockstep else {"/diagnostics": 1})


def test_the_leader_begins_when_every_uav_hears_it_and_not_others_instead(ros, scenario):
    """Viewers, a recorder beside and the sim hear the epoch too: their number says nothing."""
    uav = UavNode(
        ros.node("controller", namespace=f"/uav{LEADER}"),
        scenario,
        LEADER,
        CommunicationGraph(scenario, FlightOptions(recorded=True)),
    )
    uav.start()
    for number in range(2 * len(scenario.uav_ids)):
        Endpoints(ros.node(f"viewer{number}"), False).listen(topics.EPOCH, bytes, lambda _: None)
    epochs = uav.endpoints.readers(topics.EPOCH)
    ros.spin_until(lambda: epochs() >= 2 * len(scenario.uav_ids))
    assert topics.EPOCH.name in uav.waiting_for()

    def missing_listeners():
        return {what for what in uav.waiting_for() if what.startswith(f"{topics.EPOCH.name} at ")}

    others = [i for i in scenario.uav_ids if i != LEADER]
    ros.spin_until(
        lambda: missing_listeners() == {f"{topics.EPOCH.name} at uav{i}" for i in others}
    )
    for i in others:
        ends = Endpoints(ros.node("controller", namespace=f"/uav{i}"), False)
        ends.listen(topics.EPOCH, bytes, lambda _: None)
    ros.spin_until(lambda: not missing_listeners())


def test_no_flight_begins_by_clocks_that_differ(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)

    def told():
        others.odom(time.time_ns() - int(0.3e9))
        return any("another time" in what for what in others.uav.waiting_for())

    ros.spin_until(told)
    refused = call(ros, others.node, "start")
    assert not refused.success
    assert f"s ahead of /uav{LEADER}/odom" in refused.message


def test_no_flight_begins_beside_a_rival_and_one_in_flight_is_named(ros, scenario):
    """A fleet without a seal believes whoever publishes."""
    others = Others(ros, scenario, LEADER, lockstep=False)
    rivals = f"publisher of /uav{LEADER}/odom: /outsider and /uav2/others publish it"

    def told(text):
        others.odom(time.time_ns())
        return others.status and text in others.status[-1][1]

    for begun in (False, True):
        outsider = ros.node("outsider")
        Endpoints(outsider, lockstep=False).publisher(topics.odom(LEADER), 0)
        ros.spin_until(lambda: told(f"second {rivals}"))
        assert told(f"a single {rivals}") == (not begun)
        answer = call(ros, others.node, "start")
        assert (answer.success, rivals in answer.message) == (begun, not begun)
        ros.remove(outsider)
        ros.spin_until(lambda: not told(rivals))
        assert call(ros, others.node, "start").success


def test_real_time_a_follower_whose_parent_is_silent_says_that_it_holds_and_goes_on(ros, scenario):
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.form(time.time_ns())

    def told(state, *senders):
        now_ns = time.time_ns()
        others.odom(now_ns)
        others.neighbours(now_ns, without={PARENT, LEADER, *NEIGHBOURS} - set(senders))
        newest = others.status[-1] if others.status else (b"", "", {})
        return newest[2].get("safety") == state

    everybody = (PARENT, LEADER, *NEIGHBOURS)
    ros.spin_until(lambda: told("degraded", *everybody))  # there is no near-object sensor
    ros.spin_until(lambda: told("hold clear", LEADER))
    assert others.status[-1][1].startswith("holding; ")
    assert "estimates left out: uav2 uav4" in others.status[-1][1]
    ros.spin_until(lambda: told("degraded", *everybody))


def test_a_uav_whose_vehicle_is_gone_for_good_ends(ros, scenario):
    """A process that was started again by hand once outlived its flight."""
    ended = []
    edges = CommunicationGraph(scenario, FlightOptions())
    node = ros.node("controller", namespace=f"/uav{FOLLOWER}")
    uav = UavNode(node, scenario, FOLLOWER, edges, lambda: ended.append(True))
    uav.look_for_vehicle(1e6)  # its vehicle has not come yet
    vehicle = ros.node("vehicle")
    Endpoints(vehicle, False).publisher(topics.odom(FOLLOWER), 1)
    ros.spin_until(lambda: f"/uav{FOLLOWER}/odom" not in uav.endpoints.unheard())
    uav.look_for_vehicle(time.monotonic())
    ros.remove(vehicle)
    ros.spin_until(lambda: f"/uav{FOLLOWER}/odom" in uav.endpoints.unheard())
    uav.look_for_vehicle(time.monotonic() + 29.0)
    assert ended == []
    uav.look_for_vehicle(time.monotonic() + 31.0)
    assert ended


@pytest.mark.parametrize(
    ("sight", "state", "reason"),
    [
        ({}, SafetyState.NOMINAL, ""),
        ({"waiting_for": "/a", "flying": False}, SafetyState.NOMINAL, "waiting for /a"),
        ({"waiting_for": "/a"}, SafetyState.DEGRADED, "waiting for /a"),
        ({"near_stale": True}, SafetyState.DEGRADED, "near objects are stale: slow"),
        ({"silent_estimates": "uav2"}, SafetyState.DEGRADED, "estimates left out: uav2"),
        ({"missed_ticks": 3}, SafetyState.DEGRADED, "3 ticks missed since the last status"),
        ({"intruder": "/b: again"}, SafetyState.DEGRADED, "/b: again"),
        ({"holding": True}, SafetyState.HOLD_CLEAR, "holding"),
        ({"holding": True, "slots_fault": "no slots"}, SafetyState.HOLD_CLEAR, "no slots"),
        (
            {"odometry_stale": True, "clock_offset": "clock 0.2 s ahead"},
            SafetyState.STOP,
            "own odometry is stale: no setpoints; clock 0.2 s ahead",
        ),
    ],
)
def test_what_a_uav_notices_and_its_state(sight, state, reason):
    found = assess(planner_concerns(PlannerSight(**sight)))
    assert (found.state, found.reason) == (state, reason)
