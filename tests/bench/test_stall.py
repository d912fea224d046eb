"""A stalled UAV in closed loop: the inner loop of its vehicle keeps it near its path."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from bench.scenarios import grid
from bench.stall import Holding, Stall, off_m
from ptnsbc_sim.world import World


@pytest.mark.parametrize("sim_as_well", [False, True], ids=["the UAV", "the sim as well"])
def test_a_vehicle_that_holds_its_wrench_leaves_its_path_and_one_with_an_inner_loop_does_not(
    sim_as_well: bool,
) -> None:
    """0.2 s without a setpoint, 0.08 s after its position jumped by 7 cm."""
    scenario = grid(2, 50, 12.0).with_({"formation.avoidance": "off"})
    stall = Stall(400, 10, sim_as_well, np.array([0.07, 0.0, 0.0]), 4)
    assert off_m(scenario, stall, World) < 0.1
    assert off_m(scenario, stall, Holding) > 1.0
