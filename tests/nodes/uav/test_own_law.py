"""A law of the user in the process of one UAV, in real time."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from uav_surroundings import FOLLOWER, LEADER, PARENT, Others, body

from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

MINE = """
def mine(inputs):
    # towards the parent, from where it is heard
    return 0.1 * (inputs.positions[1] - inputs.position)
"""
CHILD = 4
WANTED = 0.1 * (body(PARENT) - body(FOLLOWER))[:3]


def test_in_real_time_a_follower_commands_what_its_law_gives(ros, tmp_path):
    (tmp_path / "mine.py").write_text(MINE, "utf-8")
    keys = {"law": f"{tmp_path}/mine.py:mine", "formation.avoidance": "off"}
    others = Others(ros, load_scenario("paper_5_free", keys), FOLLOWER, lockstep=False)
    assert sorted(others.send_state) == [LEADER, PARENT, CHILD]

    def commanded():
        """The newest velocity [m/s, ENU]; the body has no tilt and no heading."""
        now = time.time_ns()
        others.odom(now)
        others.neighbours(now)
        return others.states[-1].values[7:10] if others.states else np.full(3, np.nan)

    ros.spin_until(lambda: np.array_equal(commanded(), np.zeros(3)))  # before the epoch
    others.form(time.time_ns())
    ros.spin_until(lambda: np.allclose(commanded(), WANTED, atol=1e-6))
