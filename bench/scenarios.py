"""Scenarios of any size to measure with: a binary tree of UAVs on a grid, around a hovering leader."""

from __future__ import annotations

import yaml

from paper.experiments.cost import binary_tree
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text

# Slower than the paper's: three neighbours at 50 Hz leave less room for an explicit step.
_ESTIMATOR = {"deadline_s": 3, "residual": 1e-2, "k1_1_s": 5, "k2": 3.5, "boundary": 1.2}


def paper(duration_s: float) -> Scenario:
    """The paper's five UAVs among two obstacles: 100 Hz, 500 Hz physics, avoidance on."""
    return load_scenario("paper_5", {"timing.duration_s": float(duration_s)})


def grid(size: int, control_hz: int, duration_s: float) -> Scenario:
    """`size` UAVs, 2 m apart; UAV i forms up on i // 2 and hears the leader, as in the paper."""
    timing = {"control_hz": control_hz, "physics_hz": 500, "duration_s": float(duration_s)}
    file = binary_tree(size, timing, {"range_m": 4, "rate_hz": 10})
    gains = yaml.safe_load(load_scenario("paper_5").text)["gains"]
    file |= {"name": f"grid_{size}", "gains": {**gains, "estimator": _ESTIMATOR}}
    return scenario_from_text(yaml.safe_dump(file, sort_keys=False), source=f"grid of {size}")
