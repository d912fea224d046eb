"""The messages that a re-run keeps for its steps, and for how long."""

import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.bag import BagMessage
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.replay.drivers import ReplayState


def test_counters_of_steps_that_are_not_made_do_not_pile_up():
    state = ReplayState(load_scenario("paper_5"), [1])
    kept = state.uavs[1].recorded_counters
    for tick in range(0, 5000, 20):
        data = diagnostics(tick, "uav1: planner", DiagnosticLevel.OK, "", {"ticks": str(tick)})
        state.put(BagMessage(topics.DIAGNOSTICS.name, tick, bytes(data)))
        assert tick in kept  # the newest is there for its step
    assert len(kept) < 100
