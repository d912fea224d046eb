"""Obstacles of a scenario: their keys, where they are, and how far from them a place is."""

import numpy as np
import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.scenario.obstacles import Obstacle

WALL = {
    "name": "wall",
    "kind": "box",
    "position_m": [1, 2, 3],
    "size_m": [4, 2, 6],
    "keep_out_m": 0.5,
}


def obstacle(**keys) -> Obstacle:
    (found,) = load_scenario(
        "paper_5", {"world.obstacles": [{"name": "one", "keep_out_m": 0.5, **keys}]}
    ).world.bodies
    return found


def distance(one: Obstacle, *place: float, t: float = 0.0) -> float:
    return float(one.distances(np.array([place], dtype=float), np.array([t]))[0])


@pytest.mark.parametrize(
    ("keys", "place", "expected"),
    [
        ({"position_m": [1, 2, 3]}, (1, 5, 7), 5.0),
        ({"position_m": [1, 2, 3], "radius_m": 2}, (1, 5, 7), 5.0),
        ({"kind": "box", "position_m": [1, 2, 3], "size_m": [4, 2, 6]}, (6, 2, 3), 3.0),
        (
            {
                "kind": "box",
                "position_m": [1, 2, 3],
                "size_m": [4, 2, 6],
                "rotation_rad": [0, 0, 1.5707963],
            },
            (1, 6, 3),
            2.0,
        ),
        (
            {"kind": "cylinder", "position_m": [1, 2, 3], "radius_m": 1, "height_m": 2},
            (1, 2, 7),
            3.0,
        ),
        ({"kind": "cylinder", "position_m": [1, 2, 3], "radius_m": 1}, (5, 2, 700), 3.0),
        ({"kind": "plane", "position_m": [1, 2, 3], "normal": [0, 2, 0]}, (9, -2, 9), 4.0),
        ({"kind": "half_space", "position_m": [1, 2, 3], "normal": [0, 2, 0]}, (9, -2, 9), -4.0),
        ({"kind": "half_space", "position_m": [0, 0, 0], "normal": [1, 1, 1]}, (1, 1, 1), 3**0.5),
        ({"kind": "ground", "height_m": 1.5}, (9, 9, 4), 2.5),
    ],
)
def test_distances(keys, place, expected) -> None:
    assert distance(obstacle(**keys), *place) == pytest.approx(expected, abs=1e-6)


def test_a_ball_is_kept_out_of_by_the_distance_from_its_surface_as_all_bodies_are() -> None:
    """Of a sphere `keep_out_m` was the radius, of a box the distance from the surface."""
    ball = {"position_m": [1, 2, 3], "keep_out_m": 0.5}
    assert obstacle(**ball).keep_out_m == 0.5  # a point, as ever
    assert obstacle(**ball, radius_m=2).keep_out_m == 2.5
    assert obstacle(position_m=[1, 2, 3], keep_out_m=0, radius_m="2 m").keep_out_m == 2.0
    assert obstacle(**ball, radius_m=2).drawn().size.tolist() == [5.0, 5.0, 5.0]


def test_one_that_moves_is_where_its_trajectory_says_and_stands_still_before() -> None:
    path = {"kind": "line", "position_m": [1, 2, 3], "velocity_m_s": [0.5, 0, 0]}
    one = obstacle(kind="box", size_m=[2, 2, 2], trajectory=path)
    at = one.motion(np.array([-1.0, 0.0, 4.0]))
    np.testing.assert_allclose(at.positions, [[1, 2, 3], [1, 2, 3], [3, 2, 3]])
    np.testing.assert_allclose(at.velocities, [[0, 0, 0], [0.5, 0, 0], [0.5, 0, 0]])
    assert distance(one, 6, 2, 3, t=4.0) == pytest.approx(2.0)
    np.testing.assert_allclose(one.rows(np.array([4.0]))[0, :7], [3, 2, 3, 0.5, 0.5, 0, 0])


@pytest.mark.parametrize("kind", ["plane", "half_space"])
@pytest.mark.parametrize("normal", [[0, 0, 1], [0, -3, 0], [1, 2, 3]])
def test_the_axes_of_a_surface_are_a_rotation_with_its_normal(kind, normal) -> None:
    axes = obstacle(kind=kind, position_m=[0, 0, 0], normal=normal).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[:, 2], np.array(normal) / np.linalg.norm(normal))


def test_what_is_drawn() -> None:
    ball = obstacle(position_m=[1, 2, 3]).drawn()
    assert (ball.size.tolist(), ball.quaternion) == ([1.0, 1.0, 1.0], (0.0, 0.0, 0.0, 1.0))
    assert obstacle(**{key: WALL[key] for key in WALL if key != "name"}).drawn().size.tolist() == [
        4,
        2,
        6,
    ]
    pole = obstacle(kind="cylinder", position_m=[0, 0, 0], radius_m=0.5)
    assert pole.drawn().size.tolist() == [1.0, 1.0, 100.0]
    ground = obstacle(kind="ground", height_m=2.0).drawn()
    assert ground.size[:2].tolist() == [100.0, 100.0]
    assert ground.centre[2] == pytest.approx(2.0 - 0.5 * ground.size[2])


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "box"}, "world.obstacles[0].size_m: missing: expected the length"),
        ({"kind": "cylinder"}, "world.obstacles[0].radius_m: missing: expected a radius"),
        ({"kind": "plane"}, "world.obstacles[0].normal: missing: expected a direction"),
        ({"kind": "ground"}, "world.obstacles[0].position_m: not a key of kind ground"),
        ({"kind": "ball"}, 'world.obstacles[0].kind: "ball": '),
        ({"height_m": 1}, "world.obstacles[0].height_m: not a key of kind sphere"),
        ({"keep_out_m": 0}, "world.obstacles[0].keep_out_m: 0: expected > 0"),
        ({"position_m": None}, "world.obstacles[0].position_m: missing: expected either"),
        ({"kind": "cylinder", "radius_m": 1, "height_m": -1}, "height_m: -1: expected > 0"),
        ({"kind": "plane", "normal": [0, 0, 0]}, "normal: expected a direction"),
        (
            {"trajectory": {"kind": "hover", "position_m": [0, 0, 0]}},
            "position_m: given beside trajectory",
        ),
        (
            {
                "position_m": None,
                "trajectory": {"kind": "waypoints", "points_m": [[0, 0, 0], [1, 0, 0]]},
            },
            "world.obstacles[0].trajectory.times_s: expected either",
        ),
    ],
)
def test_what_does_not_fit_is_said_with_its_key(keys, said) -> None:
    block = {"name": "one", "position_m": [0, 0, 0], "keep_out_m": 0.5, **keys}
    block = {key: value for key, value in block.items() if value is not None}
    with pytest.raises(ScenarioError) as caught:
        load_scenario("paper_5", {"world.obstacles": [block]})
    assert said in str(caught.value)
