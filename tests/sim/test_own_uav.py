"""What a UAV flies by: the leader has neither law nor task, and every UAV a controller."""

from __future__ import annotations

from pathlib import Path

from ptnsbc_sim.own_uav import OURS, UavFunctions
from ptnsbc_sim.scenario import load_scenario

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


def test_by_the_part_of_the_uav() -> None:
    scenario = load_scenario(EXAMPLES / "all.yaml")
    leader, follower = (UavFunctions.of(scenario, uav) for uav in (1, 2))
    assert (leader.task, leader.law, follower.law) == (None, None, None)
    assert follower.task is not None and follower.controller is leader.controller is not None
    assert UavFunctions.of(load_scenario("paper_5_free"), 2) == OURS
