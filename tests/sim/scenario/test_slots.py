"""Slots: the minimum that it is, what belongs to a slot and what to a UAV, and the distances that follow."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.timebase import Clock, plan_duration, plan_step
from ptnsbc_core.topology import validated_topology
from ptnsbc_core.types import NEVER_RECEIVED_S
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, agent_config, load_scenario
from ptnsbc_sim.scenario.mission.shapes import nearest_places
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.slots import (
    Membership,
    SlotsError,
    View,
    changed,
    optimal_slots,
    reconfigured,
    require_slots,
    with_slots,
)

KEEP_OUT_M = 0.5
APART_M = np.sqrt(2.0) * KEEP_OUT_M  # 2 sqrt(2) radii of half a keep-out

OPEN = {"formation.assignment": "optimal"}
SWAPPED = {1: 3, 2: 5, 3: 4, 4: 1, 5: 2}


def assigned(starts: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The places (N, 3) in the order of the starts from which they are taken."""
    return places[nearest_places(starts, places, centred=True)]


@lru_cache
def planned_shares() -> np.ndarray:
    """Share (T,) of the start error that is left, as the law of a follower plans it."""
    gain = agent_config(load_scenario("paper_5"), 2).formation
    times = np.linspace(0.0, gain.duration_s, 101).tolist()
    return np.array([plan_step(plan_duration(gain), Clock(t, t, 0.01)).left for t in times])


cells = st.tuples(*[st.integers(-4, 4)] * 3)


@st.composite
def starts_and_places(draw: st.DrawFn, most: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """As many starts as places (N, 3) [m], both at least APART_M apart, on two lattices that lie askew."""
    size = draw(st.integers(2, most))
    layouts = [
        np.array(draw(st.lists(cells, min_size=size, max_size=size, unique=True)), dtype=float)
        for _ in range(2)
    ]
    angle = draw(st.floats(0.0, 1.5))
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    shift = np.array(draw(st.tuples(*[st.floats(-20.0, 20.0)] * 3)))
    wider = 1.0 + 1e-9  # than what rounding takes away
    return APART_M * wider * layouts[0], APART_M * wider * layouts[1] @ turn.T + shift


@given(starts_and_places(most=6))
def test_the_sum_of_the_squared_distances_is_that_of_the_best_of_all_orders(drawn) -> None:
    starts, places = drawn
    found = np.sum((assigned(starts, places) - starts) ** 2)
    least = min(
        np.sum((places[list(order)] - starts) ** 2) for order in permutations(range(len(starts)))
    )
    assert found == pytest.approx(least, rel=1e-9, abs=1e-6)


@given(starts_and_places(), st.tuples(*[st.floats(-50.0, 50.0)] * 3))
def test_the_minimum_does_not_depend_on_where_the_formation_is(drawn, shift) -> None:
    starts, places = drawn
    moved = assigned(starts + np.array(shift), places)
    sums = [np.sum((one - starts) ** 2) for one in (assigned(starts, places), moved)]
    assert sums[0] == pytest.approx(sums[1], rel=1e-9, abs=1e-6)


@given(starts_and_places())
def test_planned_paths_to_optimal_slots_keep_their_distance(drawn) -> None:
    starts, places = drawn
    goals = assigned(starts, places)
    path = goals + planned_shares()[:, None, None] * (starts - goals)
    for a, b in combinations(range(len(starts)), 2):
        distance = np.linalg.norm(path[:, a] - path[:, b], axis=1)
        # The bound of docs/notes/slots.md: no less than at the foot of the triangle of both ends.
        ends = distance[0], distance[-1]
        assert distance.min() >= np.prod(ends) / np.hypot(*ends) - 1e-9
        assert distance.min() >= KEEP_OUT_M - 1e-9


def test_without_the_minimum_the_same_paths_meet() -> None:
    starts = np.array([[0.0, 0, 0], [2, 0, 0]])
    path = 0.5 * (starts + starts[::-1])  # half way of a swap
    assert np.linalg.norm(path[0] - path[1]) == 0.0
    np.testing.assert_array_equal(assigned(starts, starts[::-1]), starts)


def test_one_set_of_positions_has_one_answer_when_sums_are_equal() -> None:
    starts = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 2, 0]])
    places = np.array([[0.0, 1, 0], [0, -1, 0], [0, 2, 0]])
    first = assigned(starts, places)
    for _ in range(5):
        np.testing.assert_array_equal(assigned(starts, places), first)


def test_a_position_that_is_missing_or_not_finite_is_named() -> None:
    scenario = load_scenario("paper_5", OPEN)
    here = {uav: scenario.uav(uav).position for uav in scenario.uav_ids}
    with pytest.raises(SlotsError, match="no finite position of UAV 4"):
        optimal_slots(scenario, {uav: at for uav, at in here.items() if uav != 4})
    with pytest.raises(SlotsError, match="no finite position of UAV 2"):
        optimal_slots(scenario, {**here, 2: np.array([0.0, np.nan, 0.0])})


def test_slots_are_the_scenarios_own_by_default() -> None:
    scenario = load_scenario("paper_5")
    assert not scenario.formation.has_open_slots
    assert load_scenario("paper_5", OPEN).formation.has_open_slots
    assert with_slots(scenario, {uav: uav for uav in scenario.uav_ids}) is scenario


@pytest.mark.parametrize("task", ["distance_angles", "parent_angle", "relative_position"])
def test_a_uav_flies_by_all_that_belongs_to_its_slot(task: str) -> None:
    scenario = load_scenario("paper_5", {**OPEN, "formation.task": task})
    held = with_slots(scenario, SWAPPED)
    holder = {slot: uav for uav, slot in SWAPPED.items()}
    for uav, slot in SWAPPED.items():
        taken, given = agent_config(held, uav), agent_config(scenario, slot)
        climb = agent_config(scenario, uav).clearance.climb  # stays with the UAV
        given = given._replace(clearance=given.clearance._replace(climb=climb))
        np.testing.assert_equal(tuple(taken), tuple(given))
        parent = scenario.communication.parent(slot)
        assert held.communication.parent(uav) == (None if parent is None else holder[parent])
        assert (uav in held.topology.pinned) == (slot in scenario.topology.pinned)
        heard = {holder[other] for other in scenario.topology.neighbours.get(slot, ())}
        assert held.topology.neighbours.get(uav, ()) == tuple(sorted(heard))
        np.testing.assert_array_equal(held.offset(uav), scenario.offset(slot))
    assert held.leader.id == 4


def test_what_belongs_to_a_uav_stays_with_it() -> None:
    scenario = load_scenario("paper_5", OPEN)
    held = with_slots(scenario, SWAPPED)
    assert held.uavs == scenario.uavs
    assert held.text == scenario.text
    for uav in scenario.uav_ids:
        assert held.vehicle_link(uav) == scenario.vehicle_link(uav)
        for one, other in zip(plant_config(held, uav), plant_config(scenario, uav), strict=True):
            np.testing.assert_array_equal(one, other)


def test_the_graph_is_the_one_that_the_new_links_make() -> None:
    held = with_slots(load_scenario("experiment_4", OPEN), {1: 2, 2: 1, 3: 4, 4: 3})
    links = held.communication
    made = validated_topology(
        held.leader.id, held.uav_ids, links.tree, links.leader_links, links.estimator_edges
    )
    same = held.topology._replace(
        matrix=made.matrix, lambda_min=made.lambda_min, lambda_max=made.lambda_max
    )
    assert same == made
    np.testing.assert_array_equal(held.topology.matrix, made.matrix)
    assert held.topology.lambda_min == pytest.approx(made.lambda_min, rel=1e-12)


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        ({1: 1, 2: 2, 3: 3, 4: 4}, "slots of 4 UAVs: expected those of 5; look at UAV 5"),
        ({1: 1, 2: 2, 3: 3, 4: 4, 9: 5}, "look at UAV 5, 9"),
        ({1: 1, 2: 2, 3: 3, 4: 4, 5: 4}, "no UAV or more than one takes slot 5"),
        ({1: 1, 2: 2, 3: 3, 4: 4, 5: 7}, "takes slot 5, 7"),
        ({}, "slots of 0 UAVs"),
    ],
)
def test_an_assignment_that_is_none_is_named(slots: dict[int, int], message: str) -> None:
    scenario = load_scenario("paper_5")
    with pytest.raises(SlotsError, match=message):
        require_slots(scenario, slots)
    with pytest.raises(SlotsError):
        with_slots(scenario, slots)


def test_every_uav_has_the_same_profile() -> None:
    """One time profile for all is what the distances rest on."""
    held = with_slots(load_scenario("paper_5", OPEN), SWAPPED)
    assert len({agent_config(held, uav).formation for uav in held.uav_ids}) == 1


IDS = range(1, 8)
NOBODY: frozenset[int] = frozenset()


@lru_cache
def relay(vacancy: str = "keep") -> Scenario:
    return load_scenario("relay", {"formation.vacancy": vacancy})


def tree_of(scenario: Scenario | None) -> dict[int, int]:
    assert scenario is not None
    return dict(scenario.communication.tree)


def test_children_of_a_lost_uav_follow_the_one_above_it():
    found = reconfigured(relay(), Membership(frozenset({2}), NOBODY))
    assert tree_of(found) == {3: 1, 4: 1, 5: 3, 6: 4, 7: 5}
    assert found is not None and (4 in found.topology.pinned), "4 heard of the leader from it too"


def test_the_next_in_line_leads_from_its_own_slot():
    found = reconfigured(relay(), Membership(frozenset({1}), NOBODY))
    assert tree_of(found) == {3: 2, 4: 2, 5: 3, 6: 4, 7: 5}
    assert found is not None and found.leader.id == 2
    for uav in IDS:
        assert found.offset(uav).tolist() == relay().offset(uav).tolist()
    later = reconfigured(relay(), Membership(frozenset({1, 2}), NOBODY))
    assert later is not None and later.leader.id == 3


def test_who_was_away_takes_its_slot_but_neither_the_lead_nor_a_child():
    found = reconfigured(relay(), Membership(NOBODY, frozenset({1, 3})))
    assert found is not None and found.leader.id == 2
    assert tree_of(found) == {1: 2, 3: 2, 4: 2, 5: 2, 6: 4, 7: 5}


def test_nobody_leads_when_the_line_has_ended():
    assert reconfigured(relay(), Membership(frozenset({1, 2, 3}), NOBODY)) is None


def test_those_behind_an_empty_slot_move_up():
    found = reconfigured(relay("close_up"), Membership(frozenset({2}), NOBODY))
    assert found is not None and tree_of(found) == {4: 1, 3: 1, 5: 3, 6: 4, 7: 5}
    assert found.offset(4).tolist() == relay().offset(2).tolist()
    assert found.offset(6).tolist() == relay().offset(4).tolist()


def test_with_the_leader_gone_the_successor_takes_its_slot():
    found = reconfigured(relay("close_up"), Membership(frozenset({1}), NOBODY))
    assert found is not None and found.leader.id == 2 and not found.offset(2).any()
    assert found.offset(4).tolist() == relay().offset(2).tolist()


@given(
    st.sampled_from(["keep", "close_up"]),
    st.frozensets(st.sampled_from(IDS), max_size=5),
    st.frozensets(st.sampled_from(IDS), max_size=3),
)
def test_whoever_is_there_is_in_a_tree_below_one_leader(vacancy, absent, returned):
    base, members = relay(vacancy), Membership(absent, returned - absent)
    found = reconfigured(base, members)
    if {1, 2, 3} <= absent:
        assert found is None
        return
    assert found is not None
    there = set(IDS) - absent
    assert set(found.topology.order) == there, (
        "a tree of those who are there: checked as that of a file"
    )
    assert found.topology.lambda_min > 0.0 or len(there) == 1
    parents = set(tree_of(found).values())
    assert not parents & absent
    assert not parents & members.returned - {found.leader.id}
    places = {uav: tuple(found.offset(uav).tolist()) for uav in IDS}
    assert len(set(places.values())) == len(places)
    if vacancy == "close_up":
        slots = {tuple(base.offset(slot).tolist()): slot for slot in IDS}
        taken = {slots[places[uav]] for uav in there}
        above = base.communication.tree
        if found.leader.id == 1 or 1 in absent:
            assert all(above[slot] in taken for slot in taken if slot != 1), "no gap in any line"
    else:
        assert places == {uav: tuple(base.offset(uav).tolist()) for uav in IDS}


def test_silence_longer_than_stale_s_is_an_absence_and_is_remembered():
    view, fresh = View(relay(), 2), dict.fromkeys([1, 3, 4, 5, 6, 7], 0.01)
    late = relay().uav(7).joins_ns
    assert view.at(late, late, fresh) == (NOBODY, NOBODY)
    stale = {**fresh, 5: 0.51}
    assert view.at(late + 1, late + 1, stale) == (frozenset({5}), NOBODY)
    assert view.at(late + 2, late + 2, fresh) == (NOBODY, frozenset({5}))


def test_a_process_that_begins_anew_waits_before_it_misses_anybody():
    view = View(relay(), 5)
    nothing = dict.fromkeys([1, 2, 3, 4, 6, 7], NEVER_RECEIVED_S)
    now = 20_000_000_000
    assert view.at(now, 0, nothing) == (NOBODY, frozenset({5})), "it was away itself"
    later = view.at(now + 510_000_000, 510_000_000, nothing)
    assert later.absent == {1, 2, 3, 4, 6, 7}


def test_joiner_and_leaver_are_absent_by_plan():
    view, fresh = View(relay(), 2), dict.fromkeys([1, 3, 4, 5, 6, 7], 0.01)
    assert view.at(0, 0, fresh).absent == {7}
    assert view.at(31_000_000_000, 31_000_000_000, fresh) == (frozenset({6}), frozenset({7}))


def test_only_those_with_another_place_begin_anew():
    before, after = relay(), reconfigured(relay(), Membership(frozenset({2}), NOBODY))
    assert after is not None
    assert [uav for uav in (3, 4, 5, 6, 7) if changed(before, after, uav)[0]] == [4]


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"formation.vacancy": "wait"}, "uavs[6].joins_s: expected formation.vacancy"),
        ({"leader.successors": [1]}, "leader.successors[0]: 1: expected followers"),
        ({"leader.successors": [2, 2]}, "leader.successors[1]: 2"),
        (
            {"formation.assignment": "optimal"},
            "formation.assignment: optimal: expected fixed beside",
        ),
        ({"formation.frame": "heading"}, "expected a shape that does not move"),
        ({"formation.sight_m": 0.2}, "formation.sight_m: 0.2: expected 0 beside"),
    ],
)
def test_what_does_not_fit_is_refused(keys, text):
    with pytest.raises(ScenarioError) as error:
        load_scenario("relay", keys)
    assert text in str(error.value)
