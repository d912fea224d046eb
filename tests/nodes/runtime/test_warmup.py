"""What a process loads before a flight is all that it needs in it."""

import gc

import pytest
from numba.core.dispatcher import Dispatcher

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.runtime.warmup import load_agent, load_world
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import UavController, step_time
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.world import World


@pytest.mark.compiles
@pytest.mark.slow
def test_after_loading_no_tick_waits_for_a_law():
    """Neither compiled nor read from the cache: other tests may have loaded more, never less."""
    scenario = load_scenario("paper_5")
    load_agent(scenario, scenario.leader.id)
    load_world(scenario)
    edges = CommunicationGraph(scenario, FlightOptions())
    controllers = {i: UavController(scenario, i, edges) for i in scenario.uav_ids}
    before = loaded()
    fly(scenario, edges, controllers, ticks=20)
    assert loaded() - before == set()


def loaded():
    """Name and argument types of every compiled law in this process."""
    # by type: isinstance asks what a weak proxy stands for, which may be gone
    laws = [one for one in gc.get_objects() if issubclass(type(one), Dispatcher)]
    return {(law.py_func.__qualname__, kinds) for law in laws for kinds in law.overloads}


def fly(scenario, edges, controllers, ticks):
    """Every UAV as its process ticks, the first ones before the epoch."""
    world, epochs = World(scenario), Epochs(scenario)
    epochs.announce(10 * scenario.timing.dt_ns, "form")
    for k in range(ticks):
        now_ns = k * scenario.timing.dt_ns
        at = step_time(now_ns, scenario.timing.dt_ns, epochs.at(now_ns), 0)
        for i, controller in controllers.items():
            controller.inbox.own = Stamped(now_ns, world.odometry(i))
            controller.inbox.near = Stamped(now_ns, world.near(i))
            for other in edges.senders(i).states:
                controller.inbox.state_queues[other].put(Stamped(now_ns, world.odometry(other)))
            for other in edges.senders(i).estimators:
                controller.inbox.estimate_queues[other].put(Stamped(now_ns, world.odometry(other)))
        world.step(
            {i: controller.step(at, NO_CUTOFF_NS).wrench for i, controller in controllers.items()}
        )
        for controller in controllers.values():
            assert len(controller.state.obstacle_memory)  # as the step log reads it
            controller.go_on(scenario)  # as the next leg of a mission does
