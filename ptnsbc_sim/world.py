"""The vehicles of one flight, one control period at a time: what the sim node integrates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.kernel import kernel, kernel_list
from ptnsbc_core.types import ODOMETRY_SIZE, PLANT_RIGID_BODY, Array
from ptnsbc_sim.plants.build import obstacle_rows, plant_config, start_states
from ptnsbc_sim.plants.contract import PlantConfig
from ptnsbc_sim.plants.integrate import advance, odometry
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects

NANO = 1e-9


@kernel
def _advance_all(
    states: Array,
    wrenches: Array,
    flying: NDArray[np.bool_],
    t: float,
    dt: float,
    substeps: int,
    plants: Sequence[PlantConfig],
) -> None:
    """All plant states (N, 17) by one control period, in place; who is not flying is stopped."""
    for row in range(states.shape[0]):
        if flying[row]:
            states[row] = advance(states[row], wrenches[row], t, dt, substeps, plants[row])
        elif plants[row].kind == PLANT_RIGID_BODY:
            states[row, 6:12] = 0.0
        else:
            states[row, 7:13] = 0.0


@kernel
def _measure_all(states: Array, plants: Sequence[PlantConfig]) -> Array:
    """Odometry vectors (N, 13) of all plant states (N, 17)."""
    out = np.empty((states.shape[0], ODOMETRY_SIZE))
    for row in range(states.shape[0]):
        out[row] = odometry(states[row], plants[row])
    return out


class World:
    """State of all vehicles; the same kernels as in the headless swarm, so the same bits."""

    def __init__(self, scenario: Scenario) -> None:
        """Vehicles at the scenario's starts."""
        self.ids = scenario.uav_ids
        self.tick = 0
        self._scenario = scenario
        self._row = {uav_id: row for row, uav_id in enumerate(self.ids)}
        plants = [plant_config(scenario, uav_id) for uav_id in self.ids]
        self._states = start_states(scenario, plants)
        self._plants = kernel_list(plants)
        self._wrenches = np.zeros((len(self.ids), 6))
        self._flying = np.zeros(len(self.ids), dtype=np.bool_)
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
        for row, uav_id in enumerate(self.ids):
            wrench = wrenches.get(uav_id)
            self._flying[row] = wrench is not None
            if wrench is not None:
                self._wrenches[row] = wrench
        t, dt = self.t_ns * NANO, self._scenario.dt_ns * NANO
        _advance_all(
            self._states, self._wrenches, self._flying, t, dt, self._substeps, self._plants
        )
        self.tick += 1
        self._odometry = self._measure()

    def _measure(self) -> Array:
        return _measure_all(self._states, self._plants)
