"""The data that do not change in a flight, for the page of the live view: those of a report, without samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory
from ptnsbc_tools.plotting.chart import COLOURS, DARK_COLOURS
from ptnsbc_tools.report.content import obstacles_of, uav_of

_PATH_POINTS = 400


def stage(scenario: Scenario) -> dict[str, Any]:
    """Name, UAVs, obstacles, the leader's path and the figure of errors; times [s], lengths [m]."""
    vector = leader_trajectory(scenario)
    times = np.linspace(0.0, float(scenario.timing.duration_s), _PATH_POINTS)
    path = np.array([reference(vector, float(t)).position for t in times])
    return {
        "name": scenario.name,
        "duration": float(scenario.timing.duration_s),
        "tolerance": float(scenario.formation.tolerance_m),
        "colours": {"light": COLOURS, "dark": DARK_COLOURS},
        "space": {
            "path": np.round(path, 4).ravel().tolist(),
            "bounds": _bounds(scenario, path),
            "legs": [],
            "deadlines": [],
            "uavs": [
                {**uav_of(scenario, uav), "avoiding": [], "deadlocks": []}
                for uav in scenario.uav_ids
            ],
            "obstacles": obstacles_of(scenario),
        },
        "starts": [scenario.uav(uav).position.tolist() for uav in scenario.uav_ids],
    }


def _bounds(scenario: Scenario, path: Any) -> list[list[float]]:
    """Corners of a box around the starts and around the formation all along the path."""
    offsets = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    starts = np.array([scenario.uav(uav).position for uav in scenario.uav_ids])
    low = np.min([path.min(0) + offsets.min(0), starts.min(0)], axis=0)
    high = np.max([path.max(0) + offsets.max(0), starts.max(0)], axis=0)
    return [low.tolist(), high.tolist()]
