"""One control step called from Python, beside one call of NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.scenarios import paper
from bench.session import Plan, cpu_seconds, take_turns
from bench.table import Row, Target
from paper.experiments.cost import follower_inputs
from ptnsbc_core.agent import Agent, PackedInputs
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.world import World

SVD = "NumPy 3×3 SVD"
_MATRIX = np.array([[2.0, 0.3, -0.1], [0.2, 1.0, 0.4], [-0.3, 0.1, 0.5]])
_FOLLOWER = 3
_T_S = 2.0


def numpy_svd() -> object:
    """The reference: a step that is written with NumPy makes many such calls."""
    return np.linalg.svd(_MATRIX)


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    calls, repeats = plan.of(3000, 300), plan.of(15, 3)
    scenario = paper(1.0)
    config, dt = agent_config(scenario, _FOLLOWER), 0.01
    known = follower_inputs(scenario, World(scenario), _FOLLOWER)
    agent = Agent(config, known.own)

    vector = PackedInputs.pack(known)

    def agent_advance() -> object:
        return agent.advance(vector, _T_S, dt)

    for warm in (agent_advance, numpy_svd):
        warm()
    turns = {
        "svd": lambda: 1e6 * cpu_seconds(numpy_svd, calls),
        "advance": lambda: 1e6 * cpu_seconds(agent_advance, calls),
    }
    times = take_turns(turns, repeats)
    advance, target = times["advance"], Target(5.0)
    name = "Agent.advance, as a tick calls it"
    return [Row(name, advance, "µs", SVD, times["svd"], target=target)]
