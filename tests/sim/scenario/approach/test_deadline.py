"""The shortest deadline in closed form, and `deadline_s: auto`."""

import math

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.approach.deadline import (
    MARGIN,
    limits_left,
    longest_need,
    shortest_deadlines,
    start_errors,
)
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.slots import with_slots_of_starts

LEADER_AT = np.array([0.0, 5.0, 8.0])
LINE = {"kind": "line", "position_m": [0, 0, 5], "velocity_m_s": [1.5, 2.0, 0.0]}
AUTO = {"gains.formation.deadline_s": "auto"}
OPEN = {"formation.assignment": "optimal"}


@pytest.mark.parametrize("name", ["paper_5", "paper_20", "experiment_4"])
def test_start_errors_are_distances_from_the_places(name):
    scenario = load_scenario(name)
    first = reference(leader_trajectory(scenario), 0.0).position
    for uav, error in start_errors(scenario).items():
        place = first + scenario.offset(uav)
        assert error == pytest.approx(math.dist(place, scenario.uav(uav).position))


def test_the_leader_takes_its_part_of_the_limits():
    """A circle of 5 m at 0.5 rad/s: 2.5 m/s and 1.25 m/s^2."""
    circle = {"kind": "circle", "centre_m": [0, 0, 5], "radius_m": 5.0, "rate_rad_s": 0.5}
    limits = {"gains.filter.max_speed_m_s": 8.0, "gains.filter.max_acceleration_m_s2": 4.0}
    left = limits_left(load_scenario("paper_5", {**limits, "leader.trajectory": circle}))
    assert left == pytest.approx((5.5, 2.75))
    left = limits_left(load_scenario("paper_5", {**limits, "leader.trajectory": LINE}))
    assert left == pytest.approx((5.5, 4.0))


def test_wind_takes_its_part_of_the_tilt():
    free = limits_left(load_scenario("paper_5"))
    windy = load_scenario("paper_5", {"world.wind_m_s": [0, 8, 0]})
    drag = windy.plant.rotor_limits.drag_1_s
    assert drag > 0.0
    lost = free.acceleration_m_s2 - limits_left(windy).acceleration_m_s2
    assert lost == pytest.approx(8.0 * drag)


def test_auto_is_a_number_in_the_text():
    """What a bag carries loads again to the same scenario."""
    scenario = load_scenario("paper_5", AUTO)
    deadline_s = scenario.gains.formation.deadline_s
    shortest = max(shortest_deadlines(scenario, limits_left(scenario)).values())
    assert MARGIN * shortest <= deadline_s < MARGIN * shortest + 0.1
    assert "auto" not in scenario.text
    assert scenario_from_text(scenario.text) == scenario


@pytest.mark.parametrize(
    "name", ["paper_5", "paper_5_free", "paper_20", "experiment_4", "corridor"]
)
def test_the_longest_need_is_the_largest_of_all(name):
    file = load_scenario(name)
    needs, need = shortest_deadlines(file, limits_left(file)), longest_need(file, limits_left(file))
    assert need == (max(needs, key=lambda uav: needs[uav]), max(needs.values()))


def test_auto_in_a_file_and_auto_as_an_option_are_the_same(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: paper_5\ngains:\n  formation:\n    deadline_s: auto\n")
    assert load_scenario(path) == load_scenario("paper_5", AUTO)


def test_auto_counts_from_the_slots_that_the_starts_are_given():
    """In whatever order the UAVs stand at the starts of the file, the same ways are left."""
    base = load_scenario("paper_20", {**AUTO, **OPEN})
    moved = {
        f"uavs[{row}].position_m": base.uav(uav).position.tolist()
        for row, uav in enumerate(np.roll(base.uav_ids, 7).tolist())
    }
    fixed, free = (load_scenario("paper_20", {**AUTO, **one, **moved}) for one in ({}, OPEN))
    assert free.gains.formation.deadline_s == base.gains.formation.deadline_s
    assert free.gains.formation.deadline_s < fixed.gains.formation.deadline_s
    assert start_errors(with_slots_of_starts(free)) == pytest.approx(start_errors(free))


def test_the_uav_in_the_slot_of_the_leader_needs_no_time_for_a_last_deviation():
    base = load_scenario("paper_5", OPEN)
    places = {uav: base.offset(uav) + LEADER_AT for uav in base.uav_ids}
    changes = {
        f"uavs[{row}].position_m": (places[uav % 5 + 1] + [0.0, 0.0, 3.0]).tolist()
        for row, uav in enumerate(base.uav_ids)
    }
    scenario = base.with_(changes)
    needs = shortest_deadlines(scenario, limits_left(scenario))
    assert min(needs, key=lambda uav: needs[uav]) == 5


def test_auto_is_longer_than_the_inner_loops():
    scenario = load_scenario("experiment_4", AUTO)
    inner = scenario.gains
    assert inner.formation.deadline_s > inner.estimator.deadline_s
    assert inner.formation.deadline_s > inner.force.deadline_s


def test_auto_without_room_is_refused():
    with pytest.raises(ScenarioError, match=r"auto: the leader's motion leaves -0.50 m/s"):
        load_scenario(
            "paper_5", {**AUTO, "leader.trajectory": LINE, "gains.filter.max_speed_m_s": 2.0}
        )


def test_another_word_is_refused():
    with pytest.raises(ScenarioError, match="deadline_s"):
        load_scenario("paper_5", {"gains.formation.deadline_s": "soon"})
