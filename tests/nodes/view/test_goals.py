"""A mission that is followed for a client, with the leader and all others played by the test."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("ptnsbc_interfaces", reason="make setup builds its messages where g++ is")

from action_msgs.msg import GoalStatus
from ptnsbc_interfaces.msg import LegOutcome

from ptnsbc_sim.scenario import load_scenario
from tests.support.operated_fleet import Fleet

pytestmark = pytest.mark.ros


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
