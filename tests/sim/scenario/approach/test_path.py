"""The planned path in the world, against closed forms and against flights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.curves.turned import left_at, scaled
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.approach.deadline import (
    limits_left,
    shortest_deadlines,
    starts_of,
    turn_of,
)
from ptnsbc_sim.scenario.approach.path import (
    APART_M,
    approach_peaks,
    candidates,
    demands,
    distances,
    pairs_of,
    plan_durations,
    planned_paths,
)
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.scenario import Scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.sweep.family import find_family
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_sim.sweep.rows import fly_draw
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of

HOVER = {"kind": "hover", "position_m": [0, 0, 8]}
TEN_S = {"gains.formation.deadline_s": 10.0, "timing.duration_s": 14.0}


def flown_along(
    trajectory: dict[str, object], starts: dict[int, list[float]], **more: object
) -> Scenario:
    """paper_5_free with a leader of its own, relative positions, and some starts."""
    rows = {f"uavs[{uav - 1}].position_m": at for uav, at in starts.items()}
    task = {"leader.trajectory": trajectory, "formation.task": "relative_position"}
    return load_scenario("paper_5_free", {**TEN_S, **task, **rows, **more})


def test_behind_a_leader_at_rest_the_peaks_are_those_of_h():
    """10 m: 2.1875 E / T of speed, and 7.513 E / T^2 of acceleration where that is the tighter limit."""
    slow = flown_along(HOVER, {1: [0, 0, 8], 5: [1.2, 7.6, 8]}, **{"plant.quadrotor.drag_1_s": 0.0})
    deadlines = np.array([4.0, 9.0])
    lasts = plan_durations(slow, deadlines)
    wanted = 2.1875 * 10.0 / lasts / slow.gains.filter.max_speed_m_s
    found = demands(slow, starts_of(slow), 5, deadlines, 0.0)
    assert (found >= wanted - 1e-3).all()
    soft = slow.with_({"gains.filter.max_acceleration_m_s2": 1.0})
    found = demands(soft, starts_of(soft), 5, deadlines, 0.0)
    assert found == pytest.approx(7.513 * 10.0 / lasts**2, rel=2e-3)


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_uav_flies_the_path_that_is_planned(turn: float):
    """A leader that starts behind its line: within 6 cm all the way, of 12 m, without avoidance."""
    line = {"kind": "line", "position_m": [2, 0, 8], "velocity_m_s": [1.5, 0.5, 0.0]}
    starts = {1: [0, 0, 8], 2: [6, 4, 8], 3: [-8, -6, 9], 4: [5, -7, 7], 5: [-3, 8, 8]}
    level = {f"uavs[{row}].attitude_rad": [0, 0, 0] for row in range(5)}
    quiet = {f"uavs[{row}].disturbance_m_s2": [0, 0, 0] for row in range(5)}
    scenario = flown_along(
        line, starts, **{**level, **quiet, "formation.turn_rad": turn, "formation.avoidance": "off"}
    )
    flight = fly(scenario)
    t = flight.t_ns * 1e-9
    for row, uav in enumerate(scenario.uav_ids):
        times, paths = planned_paths(scenario, starts_of(scenario), uav, np.array([10.0]), turn)
        flown = np.stack(
            [np.interp(times[0], t, flight.truth[:, row, k]) for k in range(3)], axis=1
        )
        assert np.linalg.norm(flown - paths[0], axis=1).max() < 0.06


def test_a_leader_that_comes_near_needs_no_time_of_its_own():
    """It flies at 4 of 8 m/s towards four UAVs 30 m ahead: the bound takes it to fly away from them."""
    line = {"kind": "line", "position_m": [0, 0, 8], "velocity_m_s": [4.0, 0.0, 0.0]}
    ahead = {uav: [30.0, 2.0 * uav - 8.0, 8.0] for uav in (2, 3, 4, 5)}
    coming = flown_along(line, {1: [0, 0, 8], **ahead})
    behind = {uav: [-x, y, z] for uav, (x, y, z) in ahead.items()}
    leaving = flown_along(line, {1: [0, 0, 8], **behind})
    needs = [max(shortest_deadlines(one, limits_left(one)).values()) for one in (coming, leaving)]
    assert needs[0] < 10.0 < needs[1]
    assert turn_of(coming) == 0.0
    assert verdict_on(recording_of(fly(coming))).verdict == "met"
    assert verdict_on(recording_of(fly(leaving))).verdict != "met"


turns = st.floats(-2.0, 2.0)


def ring(followers: int, spacing_m: float = 1.2, **changes) -> Scenario:
    """Followers evenly on a circle about the leader, each opposite to its place."""
    radius = max(spacing_m / (2.0 * math.sin(math.pi / followers)), spacing_m)
    angles = 2.0 * math.pi * np.arange(followers) / followers
    places = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    ids = list(range(2, followers + 2))
    starts = [[0.0, 0.0, 5.0], *(np.array([0.0, 0.0, 5.0]) - places).tolist()]
    text = {
        "uavs": [{"id": n + 1, "position_m": place} for n, place in enumerate(starts)],
        "formation.offsets_m": dict(zip(ids, places.tolist(), strict=True)),
        "formation.uav_keep_out_m": 0.5,
        "communication.tree": dict.fromkeys(ids, 1),
        "communication.leader_links": ids,
        "communication.estimator_edges": [],
        "communication.links": [],
        "leader.trajectory": {"kind": "line", "position_m": [0, 0, 5], "velocity_m_s": [0, 0, 0]},
        "gains.formation.deadline_s": 10.0,
    }
    return load_scenario("paper_5_free", {**text, **changes})


def planned_distances(starts: np.ndarray, places: np.ndarray, turn: float) -> np.ndarray:
    """Least distance [m] of all pairs, each UAV flown by itself along its plan."""
    errors = places - starts
    least = np.full((len(starts),) * 2, np.inf)
    for s in np.linspace(0.0, 1.0, 241).tolist():
        z = left_at(turn, s)
        at = np.array([p - scaled(z, e) for p, e in zip(places, map(tuple, errors), strict=True)])
        least = np.minimum(least, np.linalg.norm(at[:, None] - at[None], axis=2))
    return least[np.triu_indices(len(starts), 1)]


@given(seed=st.integers(0, 2**31), turn=turns)
def test_the_map_of_a_pair_is_what_both_of_it_fly(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    starts, places = rng.uniform(-6.0, 6.0, (2, 4, 3))
    starts[0] = places[0] = 0.0
    pairs = pairs_of(starts, places, np.full(4, 0.5), 0.0)
    np.testing.assert_allclose(
        distances(pairs, turn), planned_distances(starts, places, turn), atol=1e-9
    )


@given(seed=st.integers(0, 2**31), angle=st.floats(-3.0, 3.0))
def test_distances_do_not_depend_on_where_north_is(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    starts, places = rng.uniform(-6.0, 6.0, (2, 4, 3))
    c, s = math.cos(angle), math.sin(angle)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    keep = np.full(4, 0.5)
    first, second = (pairs_of(starts @ one, places @ one, keep, 0.0) for one in (np.eye(3), axes.T))
    np.testing.assert_allclose(distances(first, 0.7), distances(second, 0.7), atol=1e-9)


@pytest.mark.parametrize("followers", [3, 8, 12])
def test_a_ring_changes_sides_by_a_turn_that_keeps_it_clear(followers: int) -> None:
    scenario = ring(followers)
    turn = turn_of(scenario)
    assert turn > 0.0
    starts = np.array([scenario.uav(uav).position for uav in scenario.uav_ids])
    places = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    starts -= starts[0]
    assert planned_distances(starts, places, 0.0).min() < 0.01
    assert planned_distances(starts, places, turn).min() > 0.5 + APART_M
    assert {agent_config(scenario, uav).turn for uav in scenario.uav_ids} == {turn}


def test_pairs_that_are_clear_on_straight_lines_fly_straight() -> None:
    scenario = ring(4)
    places = {
        f"uavs[{row}].position_m": (scenario.offset(uav) + np.array([0.3, 0.2, 5.0])).tolist()
        for row, uav in enumerate(scenario.uav_ids)
    }
    assert turn_of(scenario.with_(places)) == 0.0


@pytest.mark.parametrize(("family", "seed", "k"), [("anywhere", 79, 519), ("swap", 4801, 164)])
def test_who_met_on_straight_paths_or_on_nearly_clear_turns_keeps_the_distances(
    family: str, seed: int, k: int
) -> None:
    """A turn between steps of 15 degrees keeps the first clear, none the second: on straight paths they give way."""
    text = find_family(family).read_text(encoding="utf-8")
    plan = plan_of(load_scenario("paper_5_free"), k + 1, seed=seed, family=text)
    rows, _, _ = fly_draw(plan, k)
    assert {row.flight_verdict for row in rows} == {"met"}


def test_where_no_turn_keeps_all_pairs_clear_the_paths_are_straight() -> None:
    """One flies into a ring of eight that stay, with gaps that are too narrow for anybody."""
    angles = 2.0 * math.pi * np.arange(8) / 8
    stay = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    ways = (
        np.array([[0.0, 0.0, 0.0], [2.0, 0.3, 0.0]]),
        np.array([[0.0, 0.0, 0.0], [0.45, 0.0, 0.0]]),
    )
    starts, places = (np.vstack([ends, stay]) for ends in ways)
    assert candidates(pairs_of(starts, places, np.full(10, 0.5), 0.0)) == (0.0,)


@pytest.mark.parametrize(
    "changes",
    [
        {"formation.assignment": "optimal"},
        {"formation.approach": "task"},
        {"formation.vacancy": "keep"},
        {"world.obstacles": [{"name": "O1", "position_m": [9, 9, 5], "keep_out_m": 1.0}]},
        {"formation.frame": "heading", "formation.task": "relative_position"},
    ],
)
def test_only_own_places_that_stand_still_in_free_space_are_turned_to(changes) -> None:
    assert turn_of(ring(8, **changes)) == 0.0


def test_the_scenario_may_say_the_turn() -> None:
    scenario = ring(8, **{"formation.turn_rad": -1.0})
    assert agent_config(scenario, 3).turn == -1.0
    assert turn_of(ring(8, **{"formation.turn_rad": 0.0})) == 0.0


@pytest.mark.parametrize("changes", [{"assignment": "optimal"}, {"approach": "task"}])
def test_a_turn_needs_own_places_and_the_planned_approach(changes) -> None:
    with pytest.raises(
        ScenarioError,
        match=r"formation\.(assignment|approach): \w+: expected \w+ beside formation\.turn_rad",
    ):
        ring(8, **{"formation.turn_rad": 1.0}, **{f"formation.{k}": v for k, v in changes.items()})


def test_a_turn_takes_longer_and_is_left_where_the_deadline_is_too_short() -> None:
    long, straight = ring(8), ring(8, **{"formation.turn_rad": 0.0})
    needs = [max(shortest_deadlines(one, limits_left(one)).values()) for one in (long, straight)]
    assert needs[0] > needs[1]
    between = {"gains.formation.deadline_s": 0.5 * (needs[0] + needs[1])}
    assert turn_of(ring(8, **between)) == 0.0


def test_deadline_auto_counts_the_turn() -> None:
    turned = ring(8, **{"gains.formation.deadline_s": "auto"})
    assert turn_of(turned) == turn_of(ring(8)) > 0.0


@given(turn=turns.filter(lambda turn: abs(turn) > 1e-3))
def test_peaks_of_a_turn_are_above_those_of_a_straight_line(turn: float) -> None:
    straight, turned = approach_peaks(0.0), approach_peaks(turn)
    assert turned.speed > straight.speed * 0.9999
    assert turned.acceleration > straight.acceleration * 0.999
    assert approach_peaks(-turn) == pytest.approx(turned)


@pytest.mark.parametrize(
    ("degrees", "speed", "acceleration"), [(30, 1.03, 1.16), (60, 1.23, 2.00), (90, 1.61, 3.10)]
)
def test_peaks_of_a_turn(degrees: int, speed: float, acceleration: float) -> None:
    peaks, straight = approach_peaks(math.radians(degrees)), approach_peaks(0.0)
    assert peaks.speed / straight.speed == pytest.approx(speed, abs=0.006)
    assert peaks.acceleration / straight.acceleration == pytest.approx(acceleration, abs=0.006)
