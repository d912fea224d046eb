"""Pre-flight: obstacles on the way, and whether they are seen in time."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import trajectory_vector
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings

_PATH_STEP_S = 0.05


def _path(scenario: Scenario, times: Array) -> Array:
    vector = trajectory_vector(scenario)
    return np.stack([reference(vector, float(t)).position for t in times])


def encounters(scenario: Scenario) -> Findings:
    """Obstacles on the way of the formation, taken as rigid from the deadline on."""
    deadline = scenario.gains.formation.deadline_s
    if scenario.duration_s <= deadline or not scenario.obstacles:
        return
    times = np.arange(deadline, scenario.duration_s, _PATH_STEP_S)
    path = _path(scenario, times)
    off = scenario.file.formation.avoidance == "off"
    for obstacle in scenario.obstacles:
        for uav in scenario.uav_ids:
            distance = np.linalg.norm(path + scenario.offset(uav) - obstacle.position, axis=1)
            closest = int(np.argmin(distance))
            if distance[closest] >= obstacle.keep_out_m:
                continue
            first = times[int(np.argmax(distance < obstacle.keep_out_m))]
            yield Finding(
                WARNING if off else INFO,
                f"world.obstacles {obstacle.name}",
                f"meets UAV {uav} from t = {first:.1f} s, closest {distance[closest]:.2f} m",
                f">= {obstacle.keep_out_m:g} m",
                "set formation.avoidance: set_based" if off else "avoided in flight",
            )


def sensor(scenario: Scenario) -> Findings:
    """Range of the near-object sensor against what has to be seen with it."""
    reach = max(
        [scenario.uav_keep_out_m, *(obstacle.keep_out_m for obstacle in scenario.obstacles)]
    )
    if scenario.sensor.range_m <= reach:
        yield Finding(
            ERROR,
            "sensor.range_m",
            f"{scenario.sensor.range_m:g} m",
            f"> {reach:g} m, the largest keep-out",
            "raise sensor.range_m, or nothing is seen before it is too close",
        )
