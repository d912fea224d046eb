"""One control step called from Python, and the eigen-solver inside it against LAPACK's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.scenarios import paper
from bench.session import Plan, cpu_seconds, take_turns
from bench.table import Row, Target
from paper.experiments.cost import follower_inputs
from ptnsbc_core.agent import Agent, PackedInputs
from ptnsbc_core.algebra import eigen3, gram3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.world import World

SVD = "NumPy 3×3 SVD"
_MATRIX = np.array([[2.0, 0.3, -0.1], [0.2, 1.0, 0.4], [-0.3, 0.1, 0.5]])
_FOLLOWER = 3
_T_S = 2.0


def numpy_svd() -> object:
    """The reference: a step that is written with NumPy makes many such calls."""
    return np.linalg.svd(_MATRIX)


@kernel
def jacobi_loop(matrices: Array) -> float:
    """Decompose every matrix (n, 3, 3) the way the laws do."""
    total = 0.0
    for k in range(matrices.shape[0]):
        total += eigen3(gram3(matrices[k])).values[0]
    return total


@kernel
def lapack_loop(matrices: Array) -> float:
    """The same by `np.linalg.svd`, which numba hands to LAPACK."""
    total = 0.0
    for k in range(matrices.shape[0]):
        total += np.linalg.svd(matrices[k])[1][0]
    return total


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

    matrices = np.random.default_rng(1).normal(size=(plan.of(20_000, 2_000), 3, 3))
    for warm in (agent_advance, numpy_svd):
        warm()
    loops = (jacobi_loop, lapack_loop)
    for loop in loops:
        loop(matrices[:1])
    times = take_turns(
        {
            "svd": lambda: 1e6 * cpu_seconds(numpy_svd, calls),
            "advance": lambda: 1e6 * cpu_seconds(agent_advance, calls),
            "jacobi": lambda: 1e9 * cpu_seconds(lambda: jacobi_loop(matrices)) / len(matrices),
            "lapack": lambda: 1e9 * cpu_seconds(lambda: lapack_loop(matrices)) / len(matrices),
        },
        repeats,
    )
    svd, jacobi, lapack = times["svd"], times["jacobi"], times["lapack"]
    kernel_svd = "np.linalg.svd in a kernel"
    return [
        Row(
            "Agent.advance, as a tick calls it",
            times["advance"],
            "µs",
            SVD,
            svd,
            target=Target(5.0),
        ),
        Row("singular values in a kernel: Jacobi", jacobi, "ns", kernel_svd, lapack),
    ]
