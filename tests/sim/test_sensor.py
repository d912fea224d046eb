"""Near-object sensor: what is in range, nothing of oneself, the same near the origin and far from it."""

import numpy as np
import pytest
import yaml

from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_core.tasks.signed_distance import TANGENT_RADIUS_M
from ptnsbc_sim.plants.build import obstacle_rows
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.sensor import near_objects
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict.separation import distances

KEEP_OUT, RANGE = np.array([(0.5, 0.0)] * 4), 4.0


def fleet_of(*positions) -> np.ndarray:
    out = np.zeros((len(positions), 13))
    out[:, 0:3] = positions
    out[:, 6] = 1.0
    return out


def obstacles_of(*rows) -> np.ndarray:
    """Spheres as rows of bodies."""
    out = np.zeros((len(rows), 20))
    out[:, :7] = np.array(rows, dtype=float).reshape(-1, 7)
    return out


def test_who_is_seen() -> None:
    fleet = fleet_of((0, 0, 0), (1, 0, 0), (0, 4.0, 0), (0, 0, 4.001))
    obstacles = obstacles_of((2.5, 0, 0, 1.5, 0, 0, 0), (9, 0, 0, 1.5, 0, 0, 0))
    seen = near_objects(0, fleet, obstacles, KEEP_OUT, RANGE)
    np.testing.assert_allclose(
        seen,
        [[1, 0, 0, 0.5, 0, 0, 0, 0], [0, 4, 0, 0.5, 0, 0, 0, 0], [2.5, 0, 0, 1.5, 0, 0, 0, 0]],
    )
    # the range counts to the centre, not to the surface
    assert near_objects(3, fleet, obstacles, KEEP_OUT, RANGE).shape == (0, 8)


def test_no_obstacles_and_nobody_else() -> None:
    assert near_objects(0, fleet_of((0, 0, 0)), obstacles_of(), KEEP_OUT, RANGE).shape == (0, 8)


def test_velocity_of_another_uav_is_the_worlds() -> None:
    fleet = fleet_of((0, 0, 0), (1, 1, 1))
    fleet[1, 3:7] = quaternion_from_euler(np.array([0.0, 0.0, np.pi / 2]))
    fleet[1, 7] = 2.0  # forward, which is north
    seen = near_objects(0, fleet, obstacles_of(), KEEP_OUT, RANGE)
    np.testing.assert_allclose(seen[0, 4:7], [0, 2, 0], atol=1e-6)


def test_a_pair_is_told_the_mean_of_both_keep_outs() -> None:
    fleet = fleet_of((0, 0, 0), (1, 0, 0), (2, 0, 0))
    keep_outs = np.array([(0.5, 1.5), (1.1, 3.3), (0.25, 0.75)])
    seen = near_objects(0, fleet, obstacles_of((0, 1, 0, 1.5, 0, 0, 0)), keep_outs, RANGE)
    assert seen[:, 3].tolist() == pytest.approx([0.8, 0.375, 1.5])
    assert seen[:, 7].tolist() == pytest.approx([2.4, 1.125, 0.0])  # obstacles have no downwash


@pytest.mark.parametrize(("away_m", "seen"), [(3.9, 1), (4.1, 0)])
def test_a_body_is_seen_by_its_surface_as_a_sphere_that_touches_it(
    away_m: float, seen: int
) -> None:
    keys = {"name": "wall", "kind": "box", "position_m": [10, 0, 0], "size_m": [2, 40, 40]}
    changes = {"world.obstacles": [{**keys, "keep_out_m": 0.5}]}
    bodies = obstacle_rows(load_scenario("paper_5", changes), np.zeros(1))[0]
    rows = near_objects(0, fleet_of((9 - away_m, 2, 3)), bodies, KEEP_OUT, RANGE)
    assert len(rows) == seen
    for row in rows:
        np.testing.assert_allclose(
            row, [9 + TANGENT_RADIUS_M, 2, 3, TANGENT_RADIUS_M + 0.5, 0, 0, 0, 0]
        )


_BODIES = {
    "wall": {"kind": "half_space", "normal": [-1, 0, 0]},
    "slope": {"kind": "half_space", "normal": [-1, 0, 2]},
    "screen": {"kind": "plane", "normal": [1, 0.5, 0]},
    "box": {"kind": "box", "size_m": [2, 1, 3], "rotation_rad": [0.3, 0.2, 0.7]},
    "mast": {"kind": "cylinder", "radius_m": 0.4},
    "disc": {"kind": "cylinder", "radius_m": 1.5, "height_m": 0.5},
}


@pytest.mark.parametrize("kind", _BODIES)
def test_no_body_is_touched_at_any_angle(kind: str) -> None:
    """A leader whose trajectory leads straight through it, along it, and up and down beside it."""
    plants = "quadrotor", "rigid_body_6dof"
    angles = [(3, 0, -1), (1, 3, -0.5), (0.8, 0, -3), (1, 0, 3), (2, -2, -1)]
    for row, velocity in enumerate(angles):
        if kind != "slope" or np.dot(_BODIES[kind]["normal"], velocity) < 0.0:
            assert_kept_clear(_BODIES[kind], velocity, plants[row % 2], 7.0)


@pytest.mark.parametrize("kind", ["plane", "half_space"])
@pytest.mark.parametrize(
    ("normal", "velocity"),
    [
        ((-0.54, -0.13, -0.83), (0.97, -1.13, -0.08)),
        ((-0.34, -0.12, -0.93), (1.55, 3.3, 1.51)),
        ((0.26, 0.73, -0.63), (-1.27, -2.78, 0.68)),
        ((-0.23, -0.45, -0.86), (-0.91, 0.62, 0.23)),
    ],
)
def test_no_slope_is_touched_when_the_side_changes(
    kind: str, normal: tuple, velocity: tuple
) -> None:
    """Level and climb lag by unlike times, so a step along a slope would lead the vehicle into it."""
    assert_kept_clear({"kind": kind, "normal": list(normal)}, velocity, "quadrotor", 14.0)


def assert_kept_clear(body: dict, velocity: tuple, plant: str, duration_s: float) -> None:
    start = np.array([0.0, 0.0, 30.0]) - 3.0 * np.array(velocity)
    body = {"name": "it", "keep_out_m": 0.4, "position_m": [0, 0, 30], **body}
    path = {"kind": "line", "position_m": start.tolist(), "velocity_m_s": list(velocity)}
    tree = yaml.safe_load(load_scenario("paper_5_free", {"plant.kind": plant}).text) | {
        "communication": {"tree": {}, "leader_links": [], "estimator_edges": []},
        "leader": {"id": 1, "trajectory": path},
        "formation": {"task": "relative_position", "offsets_m": {}, "uav_keep_out_m": 0.5},
        "uavs": [{"id": 1, "position_m": start.tolist()}],
    }
    tree["world"]["obstacles"], tree["timing"]["duration_s"] = [body], duration_s
    scenario = scenario_from_text(yaml.safe_dump(tree))
    flown = fly(scenario)
    (found,) = scenario.world.bodies
    away = found.distances(flown.track.odometry[:, 0, :3], flown.t_ns * 1e-9)
    assert away[0] > 0.8
    assert away.min() >= found.keep_out_m


def least_distances(away: np.ndarray) -> np.ndarray:
    """Of all pairs of a flight beside an obstacle, in which everything is moved by `away` (3,)."""
    tree = yaml.safe_load(load_scenario("paper_5_free", {"timing.duration_s": 6}).text)
    place, goal = (away + np.array([[-0.5, -1.0, 3.5], [0.0, 0.0, 6.0]])).tolist()
    tree["world"]["obstacles"] = [{"name": "it", "position_m": place, "keep_out_m": 0.8}]
    tree["leader"]["trajectory"] = {"kind": "hover", "position_m": goal}
    for uav in tree["uavs"]:
        uav["position_m"] = (away + uav["position_m"]).tolist()
    scenario = scenario_from_text(yaml.safe_dump(tree))
    flight = fly(scenario)
    positions = flight.truth[:, :, :3].transpose(2, 1, 0)
    found = distances(scenario, positions, flight.t_ns * 1e-9)
    return np.concatenate([apart.min(axis=1) for *_, apart in found])


def test_far_from_the_origin_everybody_keeps_the_same_distances() -> None:
    """A float32 is 8 mm coarse there."""
    here, there = least_distances(np.zeros(3)), least_distances(np.array([1e5, -2e5, 0.0]))
    assert here[-5:].min() < 0.85  # from the obstacle
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-6)
