"""The vehicles of one flight, one control period at a time: what the sim node integrates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptnsbc_core.types import PLANT_RIGID_BODY, Array
from ptnsbc_sim.plants.build import obstacle_rows, plant_config, start_states
from ptnsbc_sim.plants.integrate import advance, odometry
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects

NANO = 1e-9


class World:
    """State of all vehicles; the same kernels as in the headless swarm, so the same bits."""

    def __init__(self, scenario: Scenario) -> None:
        """Vehicles at the scenario's starts."""
        self.ids = scenario.uav_ids
        self.tick = 0
        self._scenario = scenario
        self._row = {uav_id: row for row, uav_id in enumerate(self.ids)}
        self._configs = [plant_config(scenario, uav_id) for uav_id in self.ids]
        self._states = start_states(scenario, self._configs)
        self._obstacles = obstacle_rows(scenario)
        self._substeps = scenario.physics_hz // scenario.control_hz
        self._odometry = self._measure()

    @property
    def t_ns(self) -> int:
        """Simulated time [ns]."""
        return self.tick * self._scenario.dt_ns

    def odometry(self, uav_id: int) -> Array:
        """Odometry vector (13,) of one UAV now."""
        return self._odometry[self._row[uav_id]]

    def near(self, uav_id: int) -> Array:
        """Rows (M, 7) that the near-object sensor of one UAV sees now."""
        scenario = self._scenario
        return near_objects(
            self._row[uav_id],
            self._odometry,
            self._obstacles,
            float(scenario.uav_keep_out_m),
            float(scenario.sensor.range_m),
        )

    def step(self, wrenches: Mapping[int, Array]) -> None:
        """Advance one control period; a UAV without a wrench (6,) stays where it is, as in a hold failsafe."""
        t, dt = self.t_ns * NANO, self._scenario.dt_ns * NANO
        for row, uav_id in enumerate(self.ids):
            wrench = wrenches.get(uav_id)
            if wrench is None:
                self._stop(row)
                continue
            self._states[row] = advance(
                self._states[row], wrench, t, dt, self._substeps, self._configs[row]
            )
        self.tick += 1
        self._odometry = self._measure()

    def _measure(self) -> Array:
        rows = [odometry(x, config) for x, config in zip(self._states, self._configs, strict=True)]
        return np.stack(rows)

    def _stop(self, row: int) -> None:
        moving = slice(6, 12) if self._configs[row].kind == PLANT_RIGID_BODY else slice(7, 13)
        self._states[row, moving] = 0.0
