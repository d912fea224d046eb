"""The inner loop of a vehicle whose setpoint is late."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.integrate import keeping_attitude
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.world import World


@pytest.mark.parametrize("kind", ["quadrotor", "rigid_body_6dof"])
@pytest.mark.parametrize("hz", [100, 250])
def test_it_ends_a_rotation_and_keeps_the_force(kind: str, hz: int) -> None:
    keys = {"timing.control_hz": hz, "timing.physics_hz": 1000, "sensor.rate_hz": 10}
    scenario = load_scenario("figure_eight", {"plant.kind": kind, **keys})
    world, weight = World(scenario), plant_config(scenario, 1)
    wrench = np.array([0.0, 0.0, weight.mass * weight.gravity, 0.05, -0.04, 0.02])
    turning = dict.fromkeys(world.ids, wrench)
    for _ in range(hz // 20):
        world.step(turning)
    began = np.abs(world.truth(1)[10:13]).max()
    assert began > 0.05
    for _ in range(hz // 2):
        held = world.with_late_setpoint(1, wrench)
        np.testing.assert_array_equal(held[0:3], wrench[0:3])
        world.step({**turning, 1: held})
    assert np.abs(world.truth(1)[10:13]).max() < 0.01 * began


def test_without_rotation_it_asks_for_no_torque() -> None:
    plant = plant_config(load_scenario("paper_5"), 1)
    wrench = np.array([0.0, 0.0, 12.0, 0.3, 0.2, 0.1])
    held = keeping_attitude(wrench, np.zeros(3), plant, 0.01)
    np.testing.assert_array_equal(held, [0.0, 0.0, 12.0, 0.0, 0.0, 0.0])
