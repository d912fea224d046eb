"""What does not change in a flight."""

from __future__ import annotations

import json

import numpy as np

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.live.stage import stage


def test_it_is_json_and_has_every_uav_and_obstacle() -> None:
    scenario = load_scenario("paper_5")
    found = json.loads(json.dumps(stage(scenario), allow_nan=False))
    space = found["space"]
    assert [uav["id"] for uav in space["uavs"]] == list(scenario.uav_ids)
    assert len(space["obstacles"]) == len(scenario.world.bodies)
    assert len(found["starts"]) == len(scenario.uav_ids)
    low, high = map(np.array, space["bounds"])
    path = np.array(space["path"]).reshape(-1, 3)
    assert (low <= path).all() and (path <= high).all()
