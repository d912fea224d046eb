"""The fleet in types of ROS, with the leader and all others played by the test."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip(
    "ptnsbc_interfaces", reason="make setup-messages builds its messages where g++ is"
)

from action_msgs.msg import GoalStatus
from ptnsbc_interfaces.msg import Emergency, LegOutcome, UavState
from ptnsbc_interfaces.srv import Arm, StartLeg, Stop

from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.vehicle_messages import encode_limits
from ptnsbc_nodes.view import operator_node
from ptnsbc_nodes.view.operator_node import (
    ARM_VEHICLES,
    EMERGENCY_STOP,
    START_LEG,
)
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import PlannerLimits
from tests.support.operated_fleet import T0_S, Fleet

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


@pytest.fixture
def make(ros, scenario):
    made = []

    def build(**options):
        made.append(Fleet(ros, scenario, **options))
        return made[-1]

    yield build
    for fleet in made:
        fleet.close()


@pytest.fixture
def fleet(make, monkeypatch):
    # The leader's path is the origin in these tests.
    at_origin = SimpleNamespace(position=(0.0, 0.0, 0.0))
    monkeypatch.setattr(
        "ptnsbc_nodes.view.flight_state.reference", lambda _path, _time_s: at_origin
    )
    return make()


def test_the_state_names_who_is_not_in_place_and_who_is_silent(fleet):
    fleet.announce("form")
    fleet.off[4] = (0.3, 0.0, 0.4)
    fleet.spin_until_told(
        lambda: fleet.states and list(fleet.states[-1].not_in_place) == [4, 5], 2.5, silent=(5,)
    )
    state = fleet.states[-1]
    assert state.leg.name == "form"
    assert state.leg.epoch.sec == T0_S
    assert state.share_of_time == pytest.approx(2.5 / state.leg.predefined_time_s)
    assert state.worst_error_m == pytest.approx(0.5)
    by_id = {uav.id: uav for uav in state.uavs}
    assert by_id[4].formation_error_m == pytest.approx(0.5)
    assert by_id[5].level == UavState.STALE
    assert by_id[2].in_place
    assert not by_id[5].in_place


def test_before_the_first_leg_there_is_no_error(fleet):
    fleet.spin_until_told(lambda: fleet.states and fleet.states[-1].uavs[0].reason == "ready", 0.0)
    state = fleet.states[-1]
    assert (state.leg.name, list(state.not_in_place)) == ("", [])
    assert math.isnan(state.worst_error_m)


def test_the_limits_are_those_of_the_scenario_or_of_a_vehicle_with_lower_ones(fleet, scenario):
    fleet.announce("form")
    fleet.limits[2](encode_limits(PlannerLimits(1.5, 1e3)))
    fleet.spin_until_told(
        lambda: fleet.states and fleet.states[-1].uavs[1].limits.speed_m_s == 1.5, 1.0
    )
    told = {uav.id: uav.limits for uav in fleet.states[-1].uavs}
    most = scenario.gains.filter.max_acceleration_m_s2
    assert told[1].speed_m_s == scenario.max_speed_m_s(1)
    assert (told[1].acceleration_m_s2, told[2].acceleration_m_s2) == (most, most)


def test_the_order_that_a_bridge_obeys_is_told(fleet):
    fleet.orders.update({2: "land", 3: "kill all", 4: "apart", 5: "rubbish"})
    expected = [
        (Emergency.NONE, False),
        (Emergency.LAND, False),
        (Emergency.KILL, True),
        (Emergency.APART, False),
        (Emergency.NONE, False),
    ]

    def told():
        found = fleet.states[-1].uavs if fleet.states else []
        return [(one.emergency.order, one.emergency.all) for one in found]

    fleet.spin_until_told(lambda: told() == expected, 0.0)


def test_a_leg_is_flown_to_its_predefined_time(fleet):
    goal, result = fleet.goal("start")
    assert goal.accepted
    fleet.ros.spin_until(lambda: fleet.asked)  # after the goal has been accepted
    assert fleet.asked == ["start"]
    fleet.announce("form")
    fleet.off[2] = (1.0, 0.0, 0.0)
    fleet.spin_until_told(lambda: fleet.feedback, 1.0)
    assert list(fleet.feedback[-1].not_in_place) == [2]
    assert 0.0 < fleet.feedback[-1].share_of_time < 1.0
    fleet.off.clear()
    fleet.spin_until_told(result.done, 30.0)
    answer = result.result()
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.success
    assert answer.result.worst_error_m < 1e-6


def test_a_leg_that_is_not_in_place_at_its_end_is_aborted_with_the_names(fleet):
    _, result = fleet.goal("start")
    fleet.announce("form")
    fleet.off[3] = (0.0, 0.2, 0.0)
    fleet.spin_until_told(result.done, 30.0)
    answer = result.result()
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.message.endswith("uav3")
    assert list(answer.result.not_in_place) == [3]


def test_a_cancelled_leg_holds(fleet):
    goal, result = fleet.goal("start")
    fleet.announce("form")
    fleet.spin_until_told(lambda: fleet.feedback, 1.0)
    cancel = goal.cancel_goal_async()
    fleet.spin_until_told(lambda: cancel.done() and result.done(), 1.5)
    assert result.result().status == GoalStatus.STATUS_CANCELED
    assert fleet.asked == ["start", "hold"]


def test_the_leaders_refusal_is_the_result(fleet):
    fleet.answers["start"] = (False, "the leader waits for /uav3/odom")
    _, result = fleet.goal("start")
    fleet.spin_until_told(result.done, 0.0)
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert result.result().result.message == "the leader waits for /uav3/odom"


def test_another_leg_ends_the_goal(fleet):
    _, result = fleet.goal("start")
    fleet.announce("form")
    fleet.spin_until_told(lambda: fleet.feedback, 1.0)
    fleet.announce("land", 2.0)
    fleet.spin_until_told(lambda: result.done() and len(fleet.epochs) == 2, 2.5)
    assert [(one.epoch.sec, one.leg, one.number) for one in fleet.epochs] == [
        (round(T0_S), "form", 0),
        (round(T0_S) + 2, "land", 0),
    ]
    assert result.result().result.message == "another leg has begun: land"


def test_a_silent_leader_ends_the_goal(fleet, monkeypatch):
    monkeypatch.setattr("ptnsbc_nodes.view.operator_node._ANSWER_S", 0.5)
    _, result = fleet.goal("start")
    fleet.ros.spin_until(result.done)
    assert result.result().result.message == "the leader is silent"


def test_the_service_passes_legs_on(fleet):
    answer = fleet.call(StartLeg, START_LEG, StartLeg.Request(leg="hold"))
    assert (answer.accepted, answer.message) == (True, "leg hold")
    answer = fleet.call(StartLeg, START_LEG, StartLeg.Request(leg="dance"))
    assert not answer.accepted
    assert "expected one of start, hold, land, stop" in answer.message
    assert fleet.asked == ["hold"]


def test_the_launcher_says_whether_the_vehicles_may_arm(fleet):
    fleet.answers["arm"] = (False, "bridge3: waiting for a valid position")
    answer = fleet.call(Arm, ARM_VEHICLES, Arm.Request())
    assert (answer.accepted, answer.message) == fleet.answers["arm"]
    fleet.answers["arm"] = (True, "the vehicles arm, and take off")
    assert fleet.call(Arm, ARM_VEHICLES, Arm.Request()).accepted
    assert fleet.asked == ["arm", "arm"]


def test_an_emergency_stop_without_bridges_reaches_the_leader(fleet, monkeypatch):
    # A context of its own would not have the enclave of this process.
    monkeypatch.setattr("rclpy.init", lambda **_: pytest.fail("it opens a context"))
    answer = fleet.call(Stop, EMERGENCY_STOP, Stop.Request())
    assert answer.success
    assert answer.vehicles == ["leader: leg stop"]
    assert fleet.asked == ["stop"]


def test_a_service_that_nobody_offers_is_not_waited_for(make, monkeypatch):
    monkeypatch.setattr(operator_node, "_DISCOVERY_S", 0.0)
    monkeypatch.setattr(operator_node.LeaderClient, "ask", lambda *_: pytest.fail("it waits"))
    answer = make().operator.calls.call("cancel")
    assert (answer.accepted, answer.found) == (False, False)
    assert answer.message.endswith("/formation/cancel is not there")


def test_a_signed_fleet_takes_no_order_from_an_interface_without_a_seal(make):
    fleet = make(seal=Seal(bytes(range(32))))
    for answer in (
        fleet.call(Arm, ARM_VEHICLES, Arm.Request()).message,
        fleet.call(StartLeg, START_LEG, StartLeg.Request(leg="start")).message,
        fleet.call(Stop, EMERGENCY_STOP, Stop.Request()).vehicles[0],
    ):
        assert answer.startswith("security: signed")
    assert fleet.asked == []


def test_without_a_mission_there_is_none_to_fly(fleet):
    _, result = fleet.mission()
    fleet.spin_until_told(result.done, 0.0)
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert result.result().result.message.startswith("the scenario has no mission")


@pytest.fixture
def with_mission(ros, monkeypatch):
    # Every place stands still: the legs are in their times and their judgement.
    monkeypatch.setattr(
        "ptnsbc_nodes.view.flight_state.FlightState._goals",
        lambda flight, _places, _t: {
            uav: np.array(flight.scenario.offset(uav)) for uav in flight.scenario.uav_ids
        },
    )
    fleet = Fleet(ros, load_scenario("mission_6"))
    yield fleet
    fleet.close()


def fly(fleet, result, seconds):
    """The feedback once the state of that instant has been followed; None when the goal has ended."""
    fleet.feedback.clear()
    leg = fleet.operator.flight.epochs.scenario.legs
    share = next(
        (seconds - one.begin_s) / (one.due_s - one.begin_s)
        for one in reversed(leg)
        if one.begin_s <= seconds
    )

    def followed():
        told = fleet.feedback and fleet.feedback[-1].share_of_time
        return result.done() or (told and told == pytest.approx(min(share, 1.0)))

    fleet.spin_until_told(followed, seconds)
    return fleet.feedback[-1] if fleet.feedback else None


def test_a_mission_is_followed_to_its_last_leg(with_mission):
    fleet = with_mission
    goal, result = fleet.mission()
    assert goal.accepted
    fleet.ros.spin_until(lambda: fleet.asked)  # after the goal has been accepted
    assert fleet.asked == ["start"]
    fleet.announce("form")
    fleet.off[2] = (0.0, 1.0, 0.0)
    told = fly(fleet, result, 3.5)
    assert (told.leg, told.name, list(told.not_in_place)) == (1, "form-1", [2])
    assert (told.share_of_time, told.worst_error_m) == pytest.approx((0.5, 1.0))
    fleet.off.clear()
    for leg, seconds in enumerate((7.1, 17.1, 24.1, 30.1, 40.1, 50.0), 1):
        at = fly(fleet, result, seconds)
        assert at.leg in (leg, leg + 1)  # the next one has begun where a leg is due at its end
    fleet.spin_until_told(result.done, 59.5)
    answer = result.result()
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.message == "all 6 legs were flown"
    assert [one.number for one in answer.result.legs] == [1, 2, 3, 4, 5, 6]
    assert [one.outcome for one in answer.result.legs] == [LegOutcome.IN_PLACE] * 5 + [
        LegOutcome.BEGUN
    ]


def test_a_mission_names_the_legs_that_were_missed_and_those_that_nobody_saw(with_mission):
    fleet = with_mission
    _, result = fleet.mission()
    fleet.announce("form")
    fleet.off[3] = (0.0, 0.0, 0.9)
    fly(fleet, result, 7.1)
    fleet.off.clear()
    for seconds in (10.0, 18.5, 24.1, 30.1, 40.1, 50.0):  # leg 2 was due at 17 s
        fly(fleet, result, seconds)
    fleet.spin_until_told(result.done, 59.5)
    answer = result.result()
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.message == (
        "leg form-1: not in place when due: uav3; leg gate: no state was heard when it was due"
    )
    first = answer.result.legs[0]
    assert (first.outcome, list(first.not_in_place)) == (LegOutcome.NOT_IN_PLACE, [3])
    assert first.worst_error_m == pytest.approx(0.9)
    assert answer.result.legs[1].outcome == LegOutcome.NOT_JUDGED


def test_a_mission_begins_at_a_leg_and_ends_when_it_is_cancelled(with_mission):
    fleet = with_mission
    fleet.announce("form")
    fleet.spin_until_told(lambda: fleet.states and fleet.states[-1].leg.name == "form", 8.5)
    _, result = fleet.mission(4)
    fleet.ros.spin_until(lambda: fleet.asked)  # after the goal has been accepted
    assert fleet.asked == ["leg_4"]
    fleet.announce("mission 4", 9.0)
    fleet.spin_until_told(lambda: fleet.operator.flight.epochs.scenario.words, 8.9)
    assert fly(fleet, result, 12.0).name == "circle"
    fleet.announce("mission 0", 13.0)
    fleet.spin_until_told(result.done, 13.1)
    answer = result.result()
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert answer.result.message == "the mission was cancelled"
    assert [(one.number, one.outcome) for one in answer.result.legs] == [(4, LegOutcome.CUT_SHORT)]
    fleet.announce("mission 9", 14.0)  # there are six
    fleet.announce("hold", 15.0)
    fleet.ros.spin_until(lambda: fleet.epochs and fleet.epochs[-1].leg == "hold")
    told = [(one.leg, one.number) for one in fleet.epochs]
    assert told == [("form", 0), ("circle", 4), ("cancel", 0), ("hold", 0)]


def test_a_client_cancels_the_mission(with_mission):
    fleet = with_mission
    goal, result = fleet.mission()
    fleet.announce("form")
    fly(fleet, result, 2.0)
    cancel = goal.cancel_goal_async()
    fleet.spin_until_told(lambda: cancel.done() and result.done(), 2.5)
    assert result.result().status == GoalStatus.STATUS_CANCELED
    assert fleet.asked == ["start", "cancel"]


def test_a_hold_of_another_operator_ends_the_mission(with_mission):
    fleet = with_mission
    _, result = fleet.mission()
    fleet.announce("form")
    fly(fleet, result, 2.0)
    fleet.announce("hold", 3.0)
    fleet.spin_until_told(result.done, 3.5)
    assert result.result().status == GoalStatus.STATUS_ABORTED
    assert result.result().result.message == "another leg has begun: hold"


def test_a_mission_that_cannot_begin_says_why(with_mission):
    fleet = with_mission
    fleet.announce("form")
    fleet.spin_until_told(lambda: fleet.operator.flight.leg is not None, 1.0)
    for from_leg, reason in (
        (9, "from_leg 9: expected 0 to 6"),
        (0, "the flight has begun: expected from_leg from 2 to 6, or a fleet with --wait"),
    ):
        _, result = fleet.mission(from_leg)
        fleet.spin_until_told(result.done, 1.0)
        assert result.result().result.message == reason
    assert fleet.asked == []
