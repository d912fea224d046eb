"""Scenario files: read, validated, and turned into the configuration of every UAV."""

from ptnsbc_sim.scenario.constants import SeveralParents, agent_config, several_parents
from ptnsbc_sim.scenario.obstacles import Obstacle
from ptnsbc_sim.scenario.problems import ScenarioError
from ptnsbc_sim.scenario.reading.reader import available
from ptnsbc_sim.scenario.scenario import Scenario, load_scenario, scenario_from_text

__all__ = [
    "Scenario",
    "SeveralParents",
    "ScenarioError",
    "Obstacle",
    "agent_config",
    "available",
    "load_scenario",
    "scenario_from_text",
    "several_parents",
]
