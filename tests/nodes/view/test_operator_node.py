"""The fleet in types of ROS, with the leader and all others played by the test."""

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("ptnsbc_interfaces", reason="make setup builds its messages where g++ is")

from action_msgs.msg import GoalStatus
from ptnsbc_interfaces.msg import Emergency, UavState
from ptnsbc_interfaces.srv import Arm, StartLeg, Stop

from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits, encode_limits
from ptnsbc_nodes.view.operator_node import (
    ARM_VEHICLES,
    EMERGENCY_STOP,
    START_LEG,
)
from ptnsbc_sim.scenario import load_scenario
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


def test_an_emergency_stop_without_bridges_reaches_the_leader(fleet):
    answer = fleet.call(Stop, EMERGENCY_STOP, Stop.Request())
    assert answer.success
    assert answer.vehicles == ["leader: leg stop"]
    assert fleet.asked == ["stop"]


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
