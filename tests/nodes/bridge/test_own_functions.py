"""Functions of the user over MAVLink: bridges fly stand-ins by them, on a clock of the tests."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import MavlinkFleet

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario import agent_config, load_scenario

PLUGINS = Path(__file__).parents[3] / "examples" / "plugins"
ABOVE_M = 0.5
MINE = f"""
import math


def above(inputs):
    # the leader has the smallest id of those heard
    leader = inputs.positions[0] + inputs.ages_s[0] * inputs.velocities[0]
    velocity = inputs.velocities[0] + leader + inputs.offset - inputs.position
    velocity[2] += {ABOVE_M}
    return velocity


def bow(t):
    return 0.2 * t, 1.0 - math.cos(0.2 * t), 3.0 + 0.02 * t
"""
SCENARIO = """
extends: experiment_4
name: mine
communication: {tree: {2: 1, 3: 1, 4: 1}}
leader:
  trajectory: {kind: mine.py:bow, duration_s: 30}
"""
LAW = """
law: mine.py:above
mavlink: {takeoff_height_m: 2}
"""
TASK = f"""
mavlink: {{takeoff_height_m: 2, setpoint: attitude}}
plugins:
  task: {PLUGINS / "cylinder.py"}:cylinder
  controller: {PLUGINS / "proportional.py"}:proportional
"""


def off_place_m(fleet):
    """The way from the follower's place beside the reference of the leader to the follower [m, ENU]."""
    made = fleet.scenario
    t = (fleet.now_ns - fleet.legs[0][0]) * 1e-9
    leader = reference(agent_config(made, made.leader_id).trajectory, t).position
    return fleet.uavs[2].vehicle.flight.truth_enu - leader - made.offset(2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("functions", "expected"),
    [(LAW, [0.0, 0.0, ABOVE_M]), (TASK, [0.0, 0.0, 0.0])],
    ids=["law_and_trajectory", "task_and_controller"],
)
def test_a_follower_is_where_the_functions_lead_it_by_the_deadline(tmp_path, functions, expected):
    (tmp_path / "mine.py").write_text(MINE, "utf-8")
    file = tmp_path / "mine.yaml"
    file.write_text(SCENARIO + functions, "utf-8")
    fleet = MavlinkFleet(load_scenario(file).bridged(), "px4", gnss="perfect", count=2)
    fleet.airborne().form().run(10.5)
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}, fleet.report()
    np.testing.assert_allclose(off_place_m(fleet), expected, atol=0.1)
