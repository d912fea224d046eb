"""Families of scenarios: every draw is a scenario, and as the family says."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.scenario.constants import agent_config
from ptnsbc_sim.sweep.family import families, family_from_text, find_family
from ptnsbc_sim.sweep.plan import SweepPlan, draw, drawn_scenario, drawn_values, plan_of
from ptnsbc_tools.check import geometry

BASE = load_scenario("paper_5_free")
LATER = {"delay"}  # draws a key that scenarios do not have yet


def plan_of_family(text: str, runs: int = 20) -> SweepPlan:
    return plan_of(BASE, runs, family=text)


def test_the_families_that_are_shipped() -> None:
    assert set(families()) >= {
        "near",
        "anywhere",
        "clutter",
        "swap",
        "chain",
        "delay",
        "wind",
        "slots",
    }


@pytest.mark.parametrize("name", sorted(set(families()) - LATER))
def test_every_draw_is_a_scenario(name: str) -> None:
    plan = plan_of_family(find_family(name).read_text())
    for k in range(0, plan.draws, 2):
        scenario, values = drawn_scenario(plan, k)
        assert len(scenario.uav_ids) == values["size"]
        starts = np.array([uav.position_m for uav in scenario.uavs])
        gaps = np.linalg.norm(starts[:, None] - starts[None], axis=2)
        assert gaps[np.triu_indices(len(starts), 1)].min() >= scenario.formation.uav_keep_out_m
        for obstacle in scenario.world.bodies:
            assert np.linalg.norm(starts - obstacle.position, axis=1).min() > obstacle.keep_out_m
        for uav in scenario.uav_ids:
            agent_config(scenario, uav)


@pytest.mark.parametrize("name", ["clutter", "clutter_fast"])
def test_no_obstacle_holds_a_place_when_it_is_due(name: str) -> None:
    """From the deadline on: a UAV that keeps out of the obstacle could not be in its place."""
    plan = plan_of_family(find_family(name).read_text(), 40)
    met = [geometry.meetings(drawn_scenario(plan, k)[0]) for k in range(plan.draws)]
    assert [list(of) for of in met] == [[]] * plan.draws


@pytest.mark.parametrize("name", ["clutter", "anywhere"])  # also with more UAVs than the base has
def test_a_draw_of_a_family_is_text_and_back(name: str) -> None:
    plan = plan_of_family(find_family(name).read_text())
    for k in range(5):
        assert draw(plan, k) == drawn_scenario(plan, k)[0]
        assert drawn_values(plan, k) == drawn_values(plan, k)


def test_every_uav_has_a_mass_and_inertia_of_its_own() -> None:
    plan = plan_of_family(find_family("mass").read_text())
    for k in range(3):
        scenario, values = drawn_scenario(plan, k)
        scales = [uav.mass_scale for uav in scenario.uavs]
        assert (values["heaviest"], values["lightest"]) == (max(scales), min(scales))
        drawn = [*scales, *(one for uav in scenario.uavs for one in uav.inertia_scale)]
        assert len(set(drawn)) == 4 * len(scales)
        assert 0.7 <= min(drawn) < max(drawn) <= 1.3


def test_a_delay_is_drawn_for_all_links() -> None:
    plan = plan_of_family(find_family("delay").read_text())
    drawn = [drawn_scenario(plan, k) for k in range(8)]
    delays = [values["delay_s"] for _, values in drawn]
    assert [scenario.communication.delay_s for scenario, _ in drawn] == delays
    assert 0.0 < min(delays) < 0.1 < max(delays) < 0.2


def test_followers_that_swap_start_at_the_place_of_another_one() -> None:
    text = "{name: s, size: 6, starts: {kind: swap, sigma_m: 0.001}, shape: {kinds: [grid]}}"
    plan = plan_of_family(text)
    for k in range(10):
        scenario, _ = drawn_scenario(plan, k)
        starts = np.array([uav.position_m for uav in scenario.uavs])
        goals = starts[0] + np.array([scenario.offset(uav) for uav in scenario.uav_ids])
        nearest = [int(np.argmin(np.linalg.norm(goals - place, axis=1))) for place in starts]
        assert nearest[0] == 0
        assert sorted(nearest) == list(range(6))
        assert all(row != place for row, place in enumerate(nearest) if row)


def test_a_random_tree_is_no_deeper_than_asked() -> None:
    plan = plan_of_family("{name: t, size: 9, tree: {kinds: [random], depth: 2}}")
    depths = {max(drawn_scenario(plan, k)[0].topology.depth.values()) for k in range(20)}
    assert depths <= {1, 2}


def test_the_deadline_is_a_multiple_of_the_feasible_one() -> None:
    text = "{name: d, starts: {kind: box}, deadline: {of_feasible: 2, at_least_s: 0, after_s: 3}}"
    plan = plan_of_family(text)
    scenario, values = drawn_scenario(plan, 0)
    assert scenario.gains.formation.deadline_s == values["deadline_s"]
    assert scenario.timing.duration_s == pytest.approx(values["deadline_s"] + 3.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{name: x, sise: 3}", "sise: unknown key"),
        ("{name: x, deadline: {seconds: 3, of_feasible: 2}}", "expected one of"),
        ("{name: x, tree: {kinds: [ring]}}", "ring"),
    ],
)
def test_a_wrong_family_is_named(text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        family_from_text(text)


def test_a_family_that_is_not_there_is_named() -> None:
    with pytest.raises(ScenarioError, match="expected one of: anywhere"):
        find_family("nowhere")


def test_open_slots_and_the_distance_of_starts() -> None:
    plan = plan_of_family(find_family("slots").read_text(), runs=5)
    for k in range(5):
        scenario, _ = drawn_scenario(plan, k)
        shape = scenario.formation
        assert (shape.assignment, shape.task) == ("optimal", "relative_position")
        starts = np.array([uav.position_m for uav in scenario.uavs])
        gaps = np.linalg.norm(starts[:, None] - starts[None], axis=2)
        assert gaps[np.triu_indices(len(starts), 1)].min() >= 1.0
        assert draw(plan, k) == scenario  # disturbances that are given over and over


def test_on_a_ring_every_follower_starts_opposite_to_its_place() -> None:
    plan = plan_of_family(find_family("ring").read_text())
    for k in range(5):
        scenario, _ = drawn_scenario(plan, k)
        leader = np.array(scenario.uav(scenario.leader.id).position)
        for uav in scenario.followers:
            start = np.array(scenario.uav(uav).position) - leader
            assert start == pytest.approx(-scenario.offset(uav), abs=1e-9)


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ("size: [7, 3]", "size: [7, 3]: expected [low, high], which ascend"),
        ("starts: {sigma_m: [2, 1]}", "starts.sigma_m: [2.0, 1.0]: expected [low, high]"),
        ("path: {kinds: [circle], radius_m: 0}", "path.radius_m"),
        ("shape: {spacing_m: 0}", "shape.spacing_m"),
        ("tree: {kinds: []}", "tree.kinds: []: expected at least one entry"),
    ],
)
def test_a_range_from_which_nothing_can_be_drawn_is_named(keys: str, where: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        family_from_text(f"name: a\n{keys}")
    assert where in str(caught.value)
