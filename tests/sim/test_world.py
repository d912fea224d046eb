"""The vehicles of a flight, one control period at a time."""

import numpy as np
import pytest

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.world import World

PLANTS = ("quadrotor", "rigid_body_6dof")


def world_of(plant: str) -> World:
    return World(load_scenario("paper_5", {"plant.kind": plant}))


@pytest.mark.parametrize("plant", PLANTS)
def test_starts_as_table_2_says(plant: str) -> None:
    world = world_of(plant)
    assert (world.ids, world.tick, world.t_ns) == ((1, 2, 3, 4, 5), 0, 0)
    np.testing.assert_array_equal(world.odometry(5)[:3], [2, -1, 1])
    np.testing.assert_array_equal(world.odometry(5)[7:], np.zeros(6))
    half = np.sin(0.5) ** 3 + np.cos(0.5) ** 3
    assert world.odometry(5)[6] == pytest.approx(half)  # w of the quaternion of (1, 1, 1)


@pytest.mark.parametrize("plant", PLANTS)
def test_time_is_counted_in_ticks(plant: str) -> None:
    world = world_of(plant)
    for _ in range(3):
        world.step({uav: np.array([0.0, 0, 11.772, 0, 0, 0]) for uav in world.ids})
    assert (world.tick, world.t_ns) == (3, 30_000_000)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_uav_without_a_wrench_stays_where_it_is(plant: str) -> None:
    world = world_of(plant)
    push = np.array([0.0, 0, 20.0, 0.1, 0, 0])
    for _ in range(20):
        world.step({uav: push for uav in world.ids})
    moving, still = world.odometry(1).copy(), world.odometry(2).copy()
    assert np.linalg.norm(velocity_enu(still)) > 0.1
    for _ in range(10):
        world.step({1: push})
    np.testing.assert_array_equal(world.odometry(2)[:7], still[:7])
    np.testing.assert_array_equal(world.odometry(2)[7:], np.zeros(6))
    assert np.linalg.norm(world.odometry(1)[:3] - moving[:3]) > 0.01


def test_near_objects_are_those_of_now() -> None:
    world = world_of("quadrotor")
    seen = world.near(2)
    # UAV 1, 3, 4, 5 within 4 m, the obstacles not
    np.testing.assert_allclose(seen[:, :3], [[0, 1, 1], [-1, 0, 1], [1, 0, 1], [2, -1, 1]])
    np.testing.assert_allclose(seen[:, 3], 0.5)


@pytest.mark.parametrize("name", ["corridor", "moving_obstacles", "yard"])
def test_bodies_are_seen_as_in_the_headless_flight_to_the_last_bit(name: str) -> None:
    scenario = load_scenario(name, {"timing.duration_s": 8.0})
    flown, world = fly(scenario), World(scenario)
    seen = 0
    for tick in range(scenario.timing.ticks):
        if tick % scenario.near_every == 0:
            for row, uav in enumerate(world.ids):
                near = world.near(uav)
                np.testing.assert_array_equal(near, flown.near(tick, row))
                seen += int((near[:, 3] > 10.0).sum())
        world.step({uav: flown.track.wrench[tick, row] for row, uav in enumerate(world.ids)})
    assert seen > 0


def test_in_real_time_obstacles_are_where_they_are_since_the_epoch() -> None:
    world = World(load_scenario("moving_obstacles"))
    world.mission_s = -1.0
    np.testing.assert_allclose(world.obstacle_positions()[0], [14, -3, 8])
    world.mission_s = 2.0
    np.testing.assert_allclose(world.obstacle_positions()[0], [13, -3, 8])
