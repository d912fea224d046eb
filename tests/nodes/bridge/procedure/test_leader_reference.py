"""The motion of the leader and of the own place, as a bridge follows it."""

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.curves.trajectory import reference as leader_at
from ptnsbc_nodes.bridge.procedure.leader_reference import place_velocity
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.build import places_beside_leader


@pytest.mark.parametrize(("name", "t"), [("split_join", 18.0), ("figure_eight", 9.0)])
def test_the_formations_motion_is_that_of_the_own_place(name, t):
    """Of the head of a group that leaves, and of the tip of a V that turns."""
    found = load_scenario(name)
    config = agent_config(found, 3)
    around = np.array([t - 1e-4, t + 1e-4])
    leader = np.array([leader_at(config.trajectory, at).position for at in around])
    places = leader + places_beside_leader(found, 3, around)
    moves = place_velocity(config, t, slot_known=True)
    np.testing.assert_allclose(moves, (places[1] - places[0]) / 2e-4, atol=1e-6)
    alike = place_velocity(config, t, slot_known=False)
    np.testing.assert_allclose(alike, (leader[1] - leader[0]) / 2e-4, atol=1e-6)
    assert np.linalg.norm(moves - alike) > 0.3
