"""Near-object sensor: what is in range, nothing of oneself, in the precision of the message."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.kinematics import quaternion_from_euler, velocity_enu
from ptnsbc_sim.sensor import near_objects

KEEP_OUT, RANGE = 0.5, 4.0


def fleet_of(*positions) -> np.ndarray:
    out = np.zeros((len(positions), 13))
    out[:, 0:3] = positions
    out[:, 6] = 1.0
    return out


def obstacles_of(*rows) -> np.ndarray:
    return np.array(rows, dtype=float).reshape(-1, 7)


def test_who_is_seen() -> None:
    fleet = fleet_of((0, 0, 0), (1, 0, 0), (0, 4.0, 0), (0, 0, 4.001))
    obstacles = obstacles_of((2.5, 0, 0, 1.5, 0, 0, 0), (9, 0, 0, 1.5, 0, 0, 0))
    seen = near_objects(0, fleet, obstacles, KEEP_OUT, RANGE)
    np.testing.assert_allclose(
        seen, [[1, 0, 0, 0.5, 0, 0, 0], [0, 4, 0, 0.5, 0, 0, 0], [2.5, 0, 0, 1.5, 0, 0, 0]]
    )
    # the range counts to the centre, not to the surface
    assert near_objects(3, fleet, obstacles, KEEP_OUT, RANGE).shape == (0, 7)


def test_no_obstacles_and_nobody_else() -> None:
    assert near_objects(0, fleet_of((0, 0, 0)), np.empty((0, 7)), KEEP_OUT, RANGE).shape == (0, 7)


def test_velocity_of_another_uav_is_the_worlds() -> None:
    fleet = fleet_of((0, 0, 0), (1, 1, 1))
    fleet[1, 3:7] = quaternion_from_euler(np.array([0.0, 0.0, np.pi / 2]))
    fleet[1, 7] = 2.0  # forward, which is north
    seen = near_objects(0, fleet, np.empty((0, 7)), KEEP_OUT, RANGE)
    np.testing.assert_allclose(seen[0, 4:7], [0, 2, 0], atol=1e-6)


@given(seed=st.integers(0, 2**31))
def test_numbers_are_those_of_a_point_cloud(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fleet = fleet_of(*rng.uniform(-2.0, 2.0, (4, 3)))
    fleet[:, 3:7] = [quaternion_from_euler(e) for e in rng.uniform(-1, 1, (4, 3))]
    fleet[:, 7:10] = rng.normal(size=(4, 3))
    obstacles = np.hstack(
        [rng.uniform(-2, 2, (2, 3)), rng.uniform(0.5, 2, (2, 1)), np.zeros((2, 3))]
    )
    seen = near_objects(1, fleet, obstacles, KEEP_OUT, 100.0)
    assert seen.shape == (5, 7)
    np.testing.assert_array_equal(seen, seen.astype(np.float32).astype(np.float64))
    for row, other in zip(seen, (0, 2, 3), strict=False):
        np.testing.assert_array_equal(row[:3], fleet[other, :3].astype(np.float32))
        np.testing.assert_array_equal(row[4:], np.float32(velocity_enu(fleet[other])))
    assert seen[3, 3] == pytest.approx(obstacles[0, 3], rel=1e-6)
