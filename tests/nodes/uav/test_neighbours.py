"""The neighbours of a UAV node: one is lost, or sends numbers that are none."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from uav_surroundings import FOLLOWER, LEADER, PARENT, Others, body

from ptnsbc_io import wire
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


def test_lockstep_goes_on_without_a_lost_neighbour(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    others.odom(scenario.timing.dt_ns)
    others.neighbours(0, without=(PARENT,))
    others.settle()
    assert others.ticks() == [0]
    others.lose(wire.HeaderTemplate(f"uav{PARENT}").encode(0))
    ros.spin_until(lambda: others.ticks() == [0, 1])


BROKEN = {
    "nan": np.nan,
    "inf": np.inf,
    "huge": 1e308,
}


@pytest.mark.parametrize("value", BROKEN.values(), ids=BROKEN)
def test_a_broken_state_of_a_neighbour_is_dropped_and_named(ros, scenario, value):
    """One such number once poisoned a follower for the rest of its flight, in silence."""
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    values = body(LEADER)
    values[0] = value
    template = wire.OdometryTemplate("map", f"uav{LEADER}/base_link")
    others.send_state[LEADER](template.encode(0, values))
    others.odom(scenario.timing.dt_ns)
    others.neighbours(0)
    ros.spin_until(lambda: others.ticks() == [0, 1])
    assert np.isfinite(others.wrenches[-1].values).all()
    # The status after the refusal warns, those after it only count.
    ros.spin_until(lambda: any(told.get("refused") for _, _, told in others.status))
    level, message, told = next(one for one in others.status if one[2].get("refused"))
    assert (level, told["refused"]) == (b"\x01", f"/uav{LEADER}/formation_state=1")
    assert "1 messages refused: /uav1/formation_state: nav_msgs/Odometry: position" in message
