"""The vehicles in real time: what a wrench that is late does to them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.sim.real_time import RealTimeWorld
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.world import World

STALLED = 12  # control periods of 10 ms


@pytest.fixture
def scenario() -> Scenario:
    return load_scenario("figure_eight")


def turning(scenario: Scenario) -> np.ndarray:
    """A wrench (6,) that carries the weight and turns the vehicle."""
    plant = plant_config(scenario, 1)
    return np.array([0.0, 0.0, plant.mass * plant.gravity, 0.4, 0.0, 0.0])


def flown(scenario: Scenario) -> tuple[World, RealTimeWorld]:
    world = World(scenario)
    publishers = SimpleNamespace(publish=lambda _now_ns: None)
    real_time = RealTimeWorld(scenario, world, publishers)
    for tick in range(3):
        now_ns = tick * scenario.timing.dt_ns
        real_time.on_wrench(1, Stamped(now_ns, turning(scenario)), now_ns)
        real_time.tick(now_ns)
    return world, real_time


def tilt(world: World) -> float:
    """Angle [rad] of UAV 1 from the vertical."""
    x, y = world.truth(1)[3:5]
    return float(np.arccos(1.0 - 2.0 * (x * x + y * y)))


def held(scenario: Scenario, periods: int) -> World:
    """A world in which the wrench is held for so long."""
    world = World(scenario)
    for _ in range(periods):
        world.step({1: turning(scenario)})
    return world


def test_a_wrench_in_time_or_one_period_late_acts_as_it_is(scenario: Scenario) -> None:
    world, real_time = flown(scenario)
    for tick in (3, 4):
        real_time.tick(tick * scenario.timing.dt_ns)
    np.testing.assert_array_equal(world.truth(1), held(scenario, 5).truth(1))


@pytest.mark.parametrize("at_once", [False, True], ids=["the UAV", "the sim as well"])
def test_a_vehicle_keeps_its_attitude_while_a_process_stands_still(
    scenario: Scenario, at_once: bool
) -> None:
    """Its last torque turned it by 10 degrees in 0.12 s, and on at 3 rad/s."""
    world, real_time = flown(scenario)
    last = 2 + STALLED
    for tick in [last] if at_once else range(3, last + 1):
        real_time.tick(tick * scenario.timing.dt_ns)
    assert world.tick == last + 1
    over = held(scenario, last + 1)
    assert tilt(over) > 3.0 * tilt(world)
    assert over.truth(1)[10] > 2.0
    assert abs(world.truth(1)[10]) < 0.05
    assert "uav1" not in real_time.hovering(last * scenario.timing.dt_ns)
