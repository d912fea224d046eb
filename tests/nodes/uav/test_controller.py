"""The controller of one UAV says why it is slow."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_core.types import MODE_FORMATION
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.uav.controller import StepTime, UavController
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_sim.scenario import agent_config, load_scenario

SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("avoidance", "seen_s", "stale"),
    [("set_based", 2.6, False), ("set_based", 2.4, True), ("off", 2.4, False)],
)
def test_near_objects_that_are_not_refreshed_are_told(
    avoidance: str, seen_s: float, stale: bool
) -> None:
    scenario = load_scenario("paper_5_free", {"formation.avoidance": avoidance})
    flown = UavController(agent_config(scenario, 1), Senders(None, None, ()))
    values = np.zeros(13)
    values[6] = 1.0
    flown.inbox.own = Stamped(3 * SECOND_NS, values)
    flown.inbox.near = Stamped(round(seen_s * SECOND_NS), np.zeros((0, 7)))
    at = StepTime(3 * SECOND_NS, 10_000_000, MODE_FORMATION, 0, 0, True)
    flown.step(at, NO_CUTOFF_NS)
    assert flown.near_stale is stale
