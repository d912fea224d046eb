"""Constants of one UAV that depend on the others."""

import pytest

from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.constants import deceleration


def test_everybody_reckons_with_the_weakest_vehicle() -> None:
    scenario = load_scenario("unlike_6", {"uavs[1].max_force_n": 26.0})
    weakest = deceleration(scenario, 2)
    assert weakest < 0.5 * deceleration(scenario, 1)
    for uav in scenario.uav_ids:
        assert agent_config(scenario, uav).clearance.weakest == pytest.approx(weakest)
