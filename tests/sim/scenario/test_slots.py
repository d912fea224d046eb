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
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.mission.shapes import nearest_places
from ptnsbc_sim.scenario.slots import (
    SlotsError,
    are_open,
    optimal_slots,
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
        # The bound of docs/method.md: no less than at the foot of the triangle of both ends.
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
    assert not are_open(scenario)
    assert are_open(load_scenario("paper_5", OPEN))
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
