"""The draws of a sweep: pure, whatever else is drawn, and scenarios all of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.sweep.draws import (
    Starts,
    SweepError,
    drawn_places,
    parse_axis,
    parse_starts,
    spacing_of,
)
from ptnsbc_sim.sweep.plan import SweepPlan, draw, drawn_scenario, drawn_values, plan_of

BASE = load_scenario("paper_5_free", {"timing.duration_s": 0.5})
KAPPA = "gains.formation.kappa_1_s"
SHIPPED = sorted(path.stem for path in (Path(__file__).parents[3] / "scenarios").glob("*.yaml"))


def plan_with(runs: int = 20, *axes: str, **rest) -> SweepPlan:
    return plan_of(BASE, runs, axes=tuple(parse_axis(text) for text in axes), **rest)


def positions(plan: SweepPlan, k: int) -> np.ndarray:
    scenario, _ = drawn_scenario(plan, k)
    return np.array([uav.position_m for uav in scenario.uavs])


@given(k=st.integers(0, 19), runs=st.integers(20, 10_000), seed=st.integers(0, 2**40))
@settings(max_examples=20)
def test_a_draw_does_not_depend_on_the_number_of_runs(k: int, runs: int, seed: int) -> None:
    few = plan_with(20, f"{KAPPA}=1:3", starts=parse_starts("near:0.3"), seed=seed)
    many = replace(few, runs=runs)
    assert drawn_values(few, k) == drawn_values(many, k)
    np.testing.assert_array_equal(positions(few, k), positions(many, k))


@given(k=st.integers(0, 19))
@settings(max_examples=10)
def test_another_axis_changes_no_other_draw(k: int) -> None:
    one = plan_with(20, f"{KAPPA}=1:3", starts=parse_starts("near:0.3"))
    two = plan_with(20, "plant.mass_kg=1:1.4", f"{KAPPA}=1:3", starts=parse_starts("near:0.3"))
    assert drawn_values(one, k)[KAPPA] == drawn_values(two, k)[KAPPA]
    np.testing.assert_array_equal(positions(one, k), positions(two, k))


@given(k=st.integers(0, 49), sigma=st.floats(0.01, 2.0), seed=st.integers(0, 1000))
@settings(max_examples=30)
def test_starts_are_clear_of_each_other(k: int, sigma: float, seed: int) -> None:
    plan = plan_with(50, starts=parse_starts(f"near:{sigma}"), seed=seed)
    places = positions(plan, k)
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    least = BASE.formation.uav_keep_out_m + BASE.gains.clearance.margin_m
    assert gaps[np.triu_indices(len(places), 1)].min() >= least


def test_starts_are_clear_of_the_downwash_of_each_other() -> None:
    scenario = load_scenario("paper_5", {"formation.uav_keep_out_above_m": 1.5})
    beside = Starts("near", (1e-3,)), spacing_of(scenario, ()), np.random.default_rng(1)
    assert len(drawn_places([(0, 0, 1), (0, 0, 2.6)], *beside)) == 2
    with pytest.raises(SweepError, match="no room for UAV number 2"):
        drawn_places([(0, 0, 1), (0, 0, 2.4)], *beside)


@given(k=st.integers(0, 49))
@settings(max_examples=20)
def test_starts_in_a_box_stay_in_it(k: int) -> None:
    given_places = np.array([uav.position_m for uav in BASE.uavs])
    places = positions(plan_with(50, starts=parse_starts("box:8,6,4")), k)
    centre = given_places.mean(axis=0)
    assert (np.abs(places[:, :2] - centre[:2]) <= [4.0, 3.0]).all()
    assert (places[:, 2] >= given_places[:, 2].min()).all()
    assert (places[:, 2] <= given_places[:, 2].min() + 4.0).all()


def test_a_box_without_room_is_named() -> None:
    with pytest.raises(SweepError, match=r"no room for UAV number .* of 5"):
        plan_with(2, starts=parse_starts("box:0.2,0.2,0.2"))


def test_starts_keep_clear_of_obstacles() -> None:
    scenario = load_scenario("paper_5", {"timing.duration_s": 0.5})
    plan = plan_of(scenario, 30, starts=parse_starts("box:16,16,12"))
    for k in range(30):
        for obstacle in scenario.world.bodies:
            room = np.linalg.norm(positions(plan, k) - obstacle.position, axis=1)
            assert room.min() >= obstacle.keep_out_m


def test_draw_is_the_scenario_that_the_loop_flies() -> None:
    plan = plan_with(5, f"{KAPPA}=1:3", starts=parse_starts("near:0.3"))
    for k in range(5):
        assert draw(plan, k) == drawn_scenario(plan, k)[0]


@pytest.mark.parametrize(
    ("name", "starts"),
    [*((name, "near:0.4") for name in SHIPPED), ("paper_5", "file"), ("mission_6", "box:60,60,20")],
)
def test_a_draw_of_starts_alone_is_one_that_was_validated(name: str, starts: str) -> None:
    rest = {"starts": parse_starts(starts), "stop_after_s": 0.3, "seed": 5}
    plan = plan_of(load_scenario(name), 2, **rest)
    (found, values), whole = drawn_scenario(plan, 1), draw(plan, 1)
    assert (found, values, found.source) == (whole, {}, whole.source)
    assert found.topology.neighbours == whole.topology.neighbours
    np.testing.assert_array_equal(found.topology.matrix, whole.topology.matrix)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_starts_beyond_all_measure_are_refused_with_the_draw() -> None:
    with pytest.raises(ScenarioError, match=r"draw 0: uavs\[0\].position_m"):
        plan_with(1, starts=parse_starts("near:1e308"))


def test_the_loop_flies_the_mission_of_a_draw_too() -> None:
    plan = plan_of(load_scenario("mission_6"), 3, starts=parse_starts("near:0.3"))
    flown, whole = drawn_scenario(plan, 1)[0], draw(plan, 1)
    assert flown == whole
    assert flown.formation.changes


def test_no_sweep_is_endless() -> None:
    with pytest.raises(SweepError, match="expected 2 to 10000 points"):
        parse_axis(f"{KAPPA}=1:2:1000000000")
    with pytest.raises(
        SweepError, match="runs: 6000000 in 2 cells: expected 1 to 10000000 flights"
    ):
        plan_of(BASE, 6_000_000, axes=(parse_axis(f"{KAPPA}=1,2"),))


def test_several_lists_make_a_grid_with_replicates() -> None:
    plan = plan_with(2, "plant.mass_kg=1.0,1.2", f"{KAPPA}=1:3:3")
    assert (plan.cells, plan.draws) == (6, 12)
    cells = [tuple(drawn_values(plan, k).values()) for k in range(12)]
    assert cells[:6] == [(m, kappa) for m in (1.0, 1.2) for kappa in (1, 2, 3)]
    assert cells[:6] == cells[6:]
    seeds = {drawn_scenario(plan, k)[0].seed for k in range(12)}
    assert len(seeds) == 12


def test_normal_draws_have_the_mean_and_deviation_asked_for() -> None:
    plan = plan_with(800, f"{KAPPA}=2.0±0.1")
    values = [drawn_values(plan, k)[KAPPA] for k in range(800)]
    assert np.mean(values) == pytest.approx(2.0, abs=0.015)
    assert np.std(values) == pytest.approx(0.1, abs=0.01)


def test_a_flight_ends_at_stop_after() -> None:
    assert drawn_scenario(plan_with(1, stop_after_s=0.2), 0)[0].timing.duration_s == 0.2
    assert drawn_scenario(plan_with(1, stop_after_s=9.0), 0)[0].timing.duration_s == 0.5


def test_a_plan_is_text_and_back() -> None:
    axes = (
        f"{KAPPA}=1:3",
        "plant.mass_kg=1.2±0.1",
        "formation.task=parent_angle,relative_position",
    )
    plan = plan_with(3, *axes, starts=parse_starts("box:9,9,4"), seed=7, stop_after_s=0.3)
    assert SweepPlan.from_json(plan.to_json()) == plan


@pytest.mark.parametrize("text", ["", "a", "a=", "=1:2", "a=2:1", "a=1:2:1", "a=1±0"])
def test_a_wrong_axis_is_named(text: str) -> None:
    with pytest.raises(SweepError, match="vary"):
        parse_axis(text)


@pytest.mark.parametrize("text", ["", "near", "near:0", "box:1,2", "box:1,2,x", "there"])
def test_wrong_starts_are_named(text: str) -> None:
    with pytest.raises(SweepError, match="starts"):
        parse_starts(text)


def test_wrong_keys_and_draws_are_named() -> None:
    with pytest.raises(ScenarioError, match=r"draw 0.*kapppa"):
        plan_with(2, "gains.formation.kapppa=1:3")
    with pytest.raises(SweepError, match="runs: 0"):
        plan_with(0)
    with pytest.raises(SweepError, match="stands twice"):
        plan_with(2, f"{KAPPA}=1:3", f"{KAPPA}=1,2")
    with pytest.raises(SweepError, match="draw 2: expected 0 to 1"):
        draw(plan_with(2), 2)


@pytest.mark.parametrize(
    "rest",
    [
        {"starts": Starts("near", (0.02,))},
        {"stop_after_s": 9.0},
        {"family": "{name: few, size: 3, deadline: {of_feasible: 2}, obstacles: {count: 1}}"},
        {"axes": (parse_axis("gains.formation.kappa_1_s=2:3"),), "starts": Starts("near", (0.02,))},
    ],
)
def test_numbers_with_their_units_are_drawn_as_any_others(rest: dict[str, Any]) -> None:
    """What a draw needs of its base is read from the scenario, never from its text."""
    with_units = {
        "timing.duration_s": "12 s",
        "formation.uav_keep_out_m": "0.5 m",
        "gains.clearance.margin_m": "0.05 m",
        "gains.filter.max_speed_m_s": "8 m/s",
        "uavs[0].position_m": ["0 m", "1 m", "1 m"],
        "uavs[1].keep_out_m": "0.4 m",
    }
    numbers = {
        key: [0, 1, 1] if isinstance(value, list) else float(value.split()[0])
        for key, value in with_units.items()
    }
    drawn, same = (
        drawn_scenario(SweepPlan(load_scenario("paper_5", keys).text, 1, **rest), 0)[0]
        for keys in (with_units, numbers)
    )
    assert drawn == same
    text = draw(SweepPlan(load_scenario("paper_5", with_units).text, 1, **rest), 0)
    assert text == drawn
