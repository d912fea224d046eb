"""Simulation 2 and the experiment as shipped: in place at the deadline, nothing touched, on both plants."""

from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest

from ptnsbc_core.agent import HOLDING, PRIORITY_VIOLATION
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.deadline import MET
from ptnsbc_sim.verdict.recording import recording_of

PLANTS = ("quadrotor", "rigid_body_6dof")
DEADLINE_S = 5.0


@lru_cache
def flight(name: str, plant: str, seconds: float, approach: str = "planned") -> HeadlessFlight:
    changes = {"plant.kind": plant, "timing.duration_s": seconds, "formation.approach": approach}
    return fly(load_scenario(name, changes))


def errors(flown: HeadlessFlight, tick: int) -> np.ndarray:
    """Distance (N,) [m] from the place at one tick."""
    scenario, places = flown.flown, flown.track.odometry[tick, :, :3]
    t, leader = int(flown.t_ns[tick]) * 1e-9, list(scenario.uav_ids).index(scenario.leader.id)
    beside = [places_beside_leader(scenario, uav, np.array([t]))[0] for uav in scenario.uav_ids]
    wanted = places[leader] + np.array(beside)
    wanted[leader] = reference(leader_trajectory(scenario), t).position
    return np.linalg.norm(places - wanted, axis=1)


def separation(flown: HeadlessFlight) -> float:
    """Smallest distance [m] of two UAVs in the whole flight."""
    places = flown.track.odometry[:, :, :3]
    pairs = combinations(range(places.shape[1]), 2)
    return min(float(np.linalg.norm(places[:, a] - places[:, b], axis=1).min()) for a, b in pairs)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("name", ["paper_20", "experiment_4"])
def test_every_uav_is_in_its_place_at_the_deadline(name: str, plant: str) -> None:
    flown = flight(name, plant, 5.5)
    assert errors(flown, 0).max() > 5.0
    assert errors(flown, round(DEADLINE_S * flown.scenario.timing.control_hz)).max() < 0.05
    assert separation(flown) >= 0.5
    assert flown.track.diagnostics[:, :, HOLDING].max() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "approach", "apart_m"),
    [("rigid_body_6dof", "task", 0.9), ("quadrotor", "planned", 0.5)],
)
def test_twenty_pass_both_obstacles_and_stay_in_formation(
    plant: str, approach: str, apart_m: float
) -> None:
    """While they dodge, the angle task turns the shape; positions keep its axes, and two UAVs pass closer."""
    flown = flight("paper_20", plant, 60.0, approach)
    assert separation(flown) >= apart_m >= flown.scenario.formation.uav_keep_out_m
    for obstacle in flown.scenario.world.bodies:
        away = np.linalg.norm(flown.track.odometry[:, :, :3] - obstacle.position, axis=2)
        assert away.min() >= 1.45
    wrench = np.linalg.norm(flown.track.wrench, axis=2)
    assert wrench.max() < 500.0
    assert errors(flown, -1).max() < 0.05
    assert flown.track.diagnostics[:, :, PRIORITY_VIOLATION].max() < 1e-6


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize(
    ("name", "most_m", "apart_m"),
    [
        pytest.param("waypoints_5", 0.02, 0.7, id="more than a lap of a curve through points"),
        pytest.param("figure_eight", 0.02, 1.6, id="a V that turns with its leader"),
        pytest.param("corridor", 0.05, 0.7, id="a V that narrows between two walls"),
        pytest.param("show_20", 0.02, 0.7, id="five shapes in a minute", marks=pytest.mark.slow),
    ],
)
def test_every_uav_stays_in_its_place(name: str, most_m: float, apart_m: float, plant: str) -> None:
    """From the deadline to the end, also while the shape turns or changes; the legs of the show are at times in UTC."""
    flown = flight(name, plant, load_scenario(name).timing.duration_s)
    first = round(DEADLINE_S * flown.scenario.timing.control_hz)
    assert max(errors(flown, tick).max() for tick in range(first, len(flown.t_ns), 20)) < most_m
    assert separation(flown) >= apart_m >= flown.scenario.formation.uav_keep_out_m
    legs = verdict_on(recording_of(flown)).mission
    due_s = [5.0, 16.0, 28.0, 41.0, 55.0] if name == "show_20" else []
    assert [(leg.verdict, leg.due_s) for leg in legs] == [(MET, due) for due in due_s]


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("name", ["corridor", "moving_obstacles", "yard"])
def test_bodies_are_kept_clear_of(name: str, plant: str) -> None:
    """Every UAV is met and outside every keep-out at every instant, where each obstacle is then."""
    flown = flight(name, plant, load_scenario(name).timing.duration_s)
    times = flown.t_ns * 1e-9
    for obstacle in flown.scenario.world.bodies:
        for row in range(len(flown.scenario.uav_ids)):
            places = flown.track.odometry[:, row, :3]
            assert obstacle.distances(places, times).min() >= obstacle.keep_out_m
    assert verdict_on(recording_of(flown)).verdict == MET


@pytest.mark.parametrize("plant", PLANTS)
def test_a_mission_is_flown_leg_by_leg(plant: str) -> None:
    """Form, go, change, circle, hold, land: each by its time, and all on the ground at the end."""
    scenario = load_scenario("mission_6", {"plant.kind": plant})
    verdict = verdict_on(recording_of(fly(scenario)))
    assert verdict.verdict == "met"
    assert [leg.kind for leg in verdict.mission] == [
        "form", "go_to", "change", "follow", "hold", "land",
    ]  # fmt: skip
    assert max(leg.error_m or 0.0 for leg in verdict.mission) < 0.02
    assert [leg.due_s for leg in verdict.mission] == [7.0, 17.0, 24.0, 30.0, 40.0, 59.0]


@pytest.mark.parametrize("plant", PLANTS)
def test_a_mission_goes_from_the_ground_to_the_ground(plant: str) -> None:
    """All rise straight up at the same pace, and each leg is met."""
    flown = flight("take_off_4", plant, load_scenario("take_off_4").timing.duration_s)
    verdict = verdict_on(recording_of(flown))
    assert verdict.verdict == MET
    assert [leg.kind for leg in verdict.mission] == ["take_off", "form", "change", "hold", "land"]
    assert max(leg.error_m or 0.0 for leg in verdict.mission) < 0.02
    rising = flown.track.odometry[: round(6.0 * flown.scenario.timing.control_hz), :, :3]
    starts = np.array([flown.scenario.uav(uav).position for uav in flown.scenario.uav_ids])
    assert np.abs(rising[:, :, :2] - starts[:, :2]).max() < 0.02
    assert np.ptp(rising[:, :, 2], axis=1).max() < 0.02


def test_crazyflies_form_within_five_seconds_and_line_up_on_a_circle() -> None:
    flown = flight("crazyflie_4", "quadrotor", load_scenario("crazyflie_4").timing.duration_s)
    verdict = verdict_on(recording_of(flown))
    assert verdict.verdict == MET
    kinds = ["take_off", "form", "follow", "change", "hold", "land"]
    assert [leg.kind for leg in verdict.mission] == kinds
    form = verdict.mission[1]
    assert form.due_s - form.begin_s == 5.0
    assert separation(flown) > 0.4


@pytest.mark.parametrize("plant", PLANTS)
def test_a_formation_splits_and_joins_again(plant: str) -> None:
    """Each group on a trajectory of its own, far apart, and all in one shape at the end."""
    flown = flight("split_join", plant, load_scenario("split_join").timing.duration_s)
    verdict = verdict_on(recording_of(flown))
    assert verdict.verdict == MET
    assert [leg.kind for leg in verdict.mission] == [
        "form", "follow", "split", "change", "join", "hold",
    ]  # fmt: skip
    assert max(leg.error_m or 0.0 for leg in verdict.mission) < 0.02
    apart = flown.track.odometry[3500, [2, 4, 5, 6], :3] - flown.track.odometry[3500, 0, :3]
    assert np.linalg.norm(apart, axis=1).min() > 10.0


def test_twenty_start_and_form_as_the_file_says() -> None:
    scenario = load_scenario("paper_20")
    starts = np.array([scenario.uav(uav).position for uav in scenario.uav_ids])
    assert len(scenario.uav_ids) == 20
    assert np.abs(starts[:, :2]).max() <= 6.0
    assert max(scenario.topology.depth.values()) <= 5
    places = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    for points in (starts, places):
        gaps = [float(np.linalg.norm(a - b)) for a, b in combinations(points, 2)]
        assert min(gaps) >= 1.0
    assert np.linalg.matrix_rank(places) == 3


def test_the_experiment_starts_where_the_paper_says() -> None:
    scenario = load_scenario("experiment_4")
    starts = [scenario.uav(uav).position.tolist() for uav in scenario.uav_ids]
    assert starts == [[0.1, 1.1, 1], [-0.8, -0.8, 1], [-1, -0.1, 1], [1.1, -0.2, 1]]
    np.testing.assert_allclose(np.linalg.norm(scenario.world.wind_m_s), 2.0)
    assert scenario.timing.duration_s == 50.0


@pytest.mark.parametrize(
    "name",
    ["lattice_10", "mission_6", "relay", "split_join", "stream_5", "unlike_6", "waypoints_5"],
)
def test_a_scenario_of_its_own_is_met_whole(name: str) -> None:
    """Several parents, legs, coming and going, two groups, a stream of setpoints, unlike vehicles, waypoints."""
    flown = fly(load_scenario(name))
    assert verdict_on(recording_of(flown)).verdict == MET
    assert separation(flown) >= 0.5
