"""The motion of the leader and of the own place, as a bridge follows it."""

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.curves.trajectory import reference as leader_at
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.bridge.ports import BridgeInputs
from ptnsbc_nodes.bridge.procedure.leader_reference import LeaderReference, place_velocity
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.build import places_beside_leader


@pytest.mark.parametrize(("name", "t"), [("split_join", 18.0), ("figure_eight", 9.0)])
def test_the_formations_motion_is_that_of_the_own_place(name, t):
    """Of the head of a group that leaves, and of the tip of a V that turns."""
    found = load_scenario(name)
    config = agent_config(found, 3)
    around = np.array([t - 1e-4, t + 1e-4])
    leader = np.array([leader_at(config.trajectory, at).position for at in around])
    places = leader + places_beside_leader(found, 3, around)
    moves = place_velocity(config, t, slot_known=True)
    np.testing.assert_allclose(moves, (places[1] - places[0]) / 2e-4, atol=1e-6)
    alike = place_velocity(config, t, slot_known=False)
    np.testing.assert_allclose(alike, (leader[1] - leader[0]) / 2e-4, atol=1e-6)
    assert np.linalg.norm(moves - alike) > 0.3


RELAY = {"uavs": [{"id": i, "position_m": [3 * i, 0, 3]} for i in range(1, 8)]}
RELAY["uavs"][4] |= {"joins_s": 14.0, "leaves_s": 30.0}


def following(uav_id, **changes):
    """The reference of a bridge, one second before the first epoch."""
    made = LeaderReference(load_scenario("relay", {**RELAY, **changes}), uav_id)
    made.update(BridgeInputs(legs=[HeaderFields(1_000_000_000, "form")]))
    return made


def test_one_that_leaves_lands_and_the_others_fly_on():
    leaver, other = following(5), following(4)
    for t_s, leg, leaves in ((20, "form", False), (32, "land", True)):
        now_ns = t_s * 1_000_000_000
        assert (leaver.leg(now_ns).name, leaver.leaves(now_ns)) == (leg, leaves)
        assert (other.leg(now_ns).name, other.leaves(now_ns)) == ("form", False)
    leaver.update(BridgeInputs(legs=[HeaderFields(40_000_000_000, "land")]))
    assert leaver.leg(41_000_000_000).name == "land"


def test_one_that_has_not_joined_is_no_member_and_has_no_place():
    found = following(5)
    assert [found.is_member(t) for t in (0.0, 13.9, 14.0, 29.9, 30.0)] == [
        False, False, True, True, False
    ]  # fmt: skip


@pytest.mark.parametrize(("vacancy", "slots"), [("keep", 1), ("close_up", 7)])
def test_the_places_that_a_vehicle_may_have_to_take(vacancy, slots):
    found = following(5, **{"formation.vacancy": vacancy})
    places = found.places(0.0)
    assert places.shape == (slots, 3)
    own = np.array(found.at(0.0).position) - np.array([4.0, 3.0, 0.0])
    assert min(np.linalg.norm(places - own, axis=1)) == pytest.approx(0.0)


def test_where_nobody_comes_or_goes_no_place_is_known():
    found = LeaderReference(load_scenario("experiment_4"), 2)
    assert found.places(0.0) is None
    assert found.is_member(5.0)
    assert not found.leaves(1_000_000_000)
