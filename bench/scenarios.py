"""Scenarios of any size to measure with: a binary tree of UAVs on a grid, around a hovering leader."""

from __future__ import annotations

import math
from typing import Any

import yaml

from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text

_SPACING_M = 2.0
_HEIGHT_M = 3.0
# Slower than the paper's: three neighbours at 50 Hz leave less room for an explicit step.
_ESTIMATOR = {"deadline_s": 3, "residual": 1e-2, "k1_1_s": 5, "k2": 3.5, "boundary": 1.2}


def paper(duration_s: float) -> Scenario:
    """The paper's five UAVs among two obstacles: 100 Hz, 500 Hz physics, avoidance on."""
    return load_scenario("paper_5", {"timing.duration_s": float(duration_s)})


def grid(size: int, control_hz: int, duration_s: float) -> Scenario:
    """`size` UAVs, 2 m apart; UAV i forms up on i // 2 and hears the leader, as in the paper."""
    text = yaml.safe_dump(_tree(size, control_hz, float(duration_s)), sort_keys=False)
    return scenario_from_text(text, source=f"grid of {size}")


def _tree(size: int, control_hz: int, duration_s: float) -> dict[str, Any]:
    paper_5: dict[str, Any] = yaml.safe_load(load_scenario("paper_5").text)
    followers = range(2, size + 1)
    places = [_place(index, size) for index in range(size)]
    return {
        "name": f"grid_{size}",
        "timing": {"control_hz": control_hz, "physics_hz": 500, "duration_s": duration_s},
        "sensor": {"range_m": 4, "rate_hz": 10},
        "plant": paper_5["plant"],
        "gains": {**paper_5["gains"], "estimator": _ESTIMATOR},
        "communication": {
            "tree": {i: i // 2 for i in followers},
            "leader_links": list(followers),
            "estimator_edges": [[i // 2, i] for i in followers if i // 2 != 1],
        },
        "leader": {"id": 1, "trajectory": {"kind": "line", "position_m": [0, 0, _HEIGHT_M]}},
        "formation": {
            "task": "relative_position",
            "offsets_m": {i: places[i - 1] for i in followers},
            "uav_keep_out_m": 0.5,
        },
        "uavs": [
            {"id": i + 1, "position_m": [x, y, _HEIGHT_M]} for i, (x, y, _) in enumerate(places)
        ],
    }


def _place(index: int, size: int) -> list[float]:
    columns = math.ceil(math.sqrt(size))
    row, column = divmod(index, columns)
    return [-_SPACING_M * row, _SPACING_M * column, 0.0]
