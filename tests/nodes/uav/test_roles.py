"""The place of a UAV in the graph, by what its process sees."""

import pytest

from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.roles import RoleHolder
from ptnsbc_sim.scenario import load_scenario

DT_NS = 10_000_000
FRESH = dict.fromkeys(range(2, 8), 0.01)


@pytest.mark.parametrize(("pause_s", "leads"), [(0.4, True), (0.6, False)])
def test_a_leader_whose_process_stood_still_knows_that_it_was_lost(pause_s, leads):
    """SIGSTOP, or a computer that is too busy: the others follow the successor by then."""
    relay = load_scenario("relay")
    role = RoleHolder(relay, 1, CommunicationGraph(relay, FlightOptions()))
    for tick in range(100):
        role.look(tick * DT_NS, 0, FRESH)
    assert role.leads
    role.look(99 * DT_NS + round(pause_s * 1e9), 0, FRESH)
    assert role.leads is leads
