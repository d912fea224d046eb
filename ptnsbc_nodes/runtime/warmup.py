"""Loading the compiled laws before a flight, so that no tick is a compilation."""

from __future__ import annotations

import sys
from importlib import import_module

import numpy as np

from ptnsbc_core.agent import Agent
from ptnsbc_core.kernel import COMPILED
from ptnsbc_core.types import ODOMETRY_SIZE
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.inbox import Inbox
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.world import World

_BLAS = "scipy.linalg"


def spare_linear_algebra() -> None:
    """Let numba come up without SciPy's BLAS, which it loads with the first law: 0.25 s of every process's start.

    No law uses it. For programs of our own: where it has been called, numba compiles no `np.dot` for anybody.
    """
    if COMPILED and _BLAS not in sys.modules:
        sys.modules[_BLAS] = None  # type: ignore[assignment] # as Python says: not to be found
        try:
            import_module("numba.np.arraymath")  # looks for it once
        finally:
            del sys.modules[_BLAS]


def load_agent(scenario: Scenario, uav_id: int) -> None:
    """Compile the laws, or load them from the cache: one step on zeros, as `Pilot` makes it."""
    config = agent_config(scenario, uav_id)
    own = np.zeros(ODOMETRY_SIZE)
    own[6] = 1.0
    inbox = Inbox(CommunicationGraph(scenario, FlightOptions()).senders(uav_id))
    inbox.own = Stamped(0, own)
    known = inbox.known(0, 0)
    Agent(config, known.unpack().own).advance(known, 0.0, scenario.dt_ns * 1e-9)


def load_world(scenario: Scenario) -> None:
    """The same for the vehicles."""
    world = World(scenario)
    world.near(scenario.leader_id)
    world.step({i: np.zeros(6) for i in world.ids})
