"""Loading the compiled laws before a flight, so that no tick is a compilation."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.agent import OWN, PARENT, Agent, PackedInputs
from ptnsbc_core.kernel import prepared
from ptnsbc_core.kinematics import move_to_present
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import NEAR_COLUMNS
from ptnsbc_sim.plugins.formation_task import NO_TASK
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.world import World


def load_agent(scenario: Scenario, uav_id: int) -> None:
    """Compile the laws, or load them from the cache: one step on zeros, as `UavController` makes it."""
    neighbours = len(scenario.topology.neighbours.get(uav_id, ()))
    inputs = PackedInputs(neighbours, np.zeros((0, NEAR_COLUMNS)))
    inputs.vector[OWN + 6] = 1.0  # the quaternion of no rotation
    prepared(move_to_present, inputs.vector[OWN:PARENT], 0.0)
    config, dt = agent_config(scenario, uav_id), seconds(scenario.timing.dt_ns)
    agent = Agent(config, inputs.unpack().own)
    if uav_id != scenario.leader.id and scenario.plugins.task is not None:
        agent.task_points(inputs, 0.0, dt)
        agent.advance(inputs, 0.0, dt, task=NO_TASK)
    else:
        guided = scenario.law is not None and uav_id != scenario.leader.id
        agent.advance(inputs, 0.0, dt, (0.0, 0.0, 0.0) if guided else None)


def load_fleet(scenario: Scenario) -> None:
    """Compile or load the laws of all UAVs: those of the leader, and of a follower that flies by the user's."""
    load_agent(scenario, scenario.leader.id)
    if scenario.followers and (scenario.law is not None or scenario.plugins.task is not None):
        load_agent(scenario, scenario.followers[0])


def load_world(scenario: Scenario) -> None:
    """Compile or load the laws of the simulated vehicles in the same way."""
    world = World(scenario)
    world.near(scenario.leader.id)
    world.step({i: np.zeros(6) for i in world.ids})
