"""The laws as numba compiles them, in every form that a flight calls."""

import numpy as np
import pytest

from ptnsbc_core.agent import OWN, PARENT, Agent, PackedInputs
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.tick import advance_all, sense, step_all
from ptnsbc_sim.world import World


def ticking(velocities=None):
    """A loop that flies tick by tick, as one with plug-ins does."""

    def fly_ticks(first, count, swarm, disturbances):
        for tick in range(first, first + count):
            sense(swarm, tick, disturbances)
            step_all(tick, swarm, velocities, None, disturbances)
            advance_all(tick, swarm, disturbances)

    return fly_ticks


@pytest.mark.compiles
def test_every_form_of_the_step_flies_the_same() -> None:
    """One process types the parts of them once; the other tests read what it has compiled."""
    short = {"timing.duration_s": 0.05}
    scenario = load_scenario("paper_5", short)
    whole = fly(scenario).track.wrench
    assert fly(scenario, loop=ticking()).track.wrench.tobytes() == whole.tobytes()
    lossy = load_scenario("paper_5", {**short, "communication.loss": 1e-12})
    assert fly(lossy).track.wrench.tobytes() == whole.tobytes()
    told = fly(scenario, loop=ticking(np.zeros((5, 3)))).track.wrench
    assert told[:, 0].tobytes() == whole[:, 0].tobytes()  # the leader is not told a velocity
    assert told[:, 1:].tobytes() != whole[:, 1:].tobytes()
    world = World(scenario)
    inputs = PackedInputs(2, world.near(2))
    inputs.vector[OWN:PARENT] = world.odometry(2)
    agent = Agent(agent_config(scenario, 2), world.odometry(2))
    for guided in (None, (0.0, 0.0, 0.0)):
        assert np.isfinite(agent.advance(inputs, 0.0, 0.01, guided).wrench).all()
    world.step({uav: np.zeros(6) for uav in world.ids})
