"""The vehicles of one flight, one control period at a time: what the sim node integrates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import kernel, kernel_list
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import ODOMETRY_SIZE, Array
from ptnsbc_sim.disturbances.build import VehicleDisturbances
from ptnsbc_sim.plants.build import obstacle_rows, plant_config, start_states
from ptnsbc_sim.plants.contract import PlantConfig
from ptnsbc_sim.plants.integrate import advance, keeping_attitude, odometry, stop
from ptnsbc_sim.plugins.world_plugins import WorldPlugins
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.wiring import keep_outs_of

_NO_WRENCH = np.zeros(6)


@kernel
def _advance_row(
    states: Array,
    row: int,
    wrench: Array,
    flying: bool,
    t: float,
    dt: float,
    substeps: int,
    plants: Sequence[PlantConfig],
) -> Array:
    """One row of states (N, 17) by one control period, in place, or standing still; and its odometry (13,)."""
    if flying:
        advance(states[row], wrench, t, dt, substeps, plants[row])
    else:
        stop(states[row], plants[row].kind)
    return odometry(states[row], plants[row])


@kernel
def measure_all(states: Array, plants: Sequence[PlantConfig]) -> Array:
    """Odometry vectors (N, 13) of all plant states (N, 17)."""
    out = np.empty((states.shape[0], ODOMETRY_SIZE))
    for row in range(states.shape[0]):
        store(out[row], 0, odometry(states[row], plants[row]))
    return out


class World:
    """State of all vehicles; the same kernels as in the headless swarm, so the same bits."""

    def __init__(self, scenario: Scenario) -> None:
        """Vehicles at the scenario's starts."""
        self.ids = scenario.uav_ids
        self._scenario = scenario
        self._row = {uav_id: row for row, uav_id in enumerate(self.ids)}
        plants = [plant_config(scenario, uav_id) for uav_id in self.ids]
        self._bodies = plants  # of inertia and motors, which no disturbance changes
        self._plants = kernel_list(plants)
        self._states = start_states(scenario, self._plants)
        self.ticks = dict.fromkeys(self.ids, 0)
        """Control periods that each vehicle has behind it."""
        self._dt_ns = scenario.timing.dt_ns
        self._obstacles = obstacle_rows(scenario, np.zeros(1))[0]
        self._keep_outs = keep_outs_of(scenario)
        self._moving = any(one.path is not None for one in scenario.world.bodies)
        self.mission_s: float | None = None
        """Time since the first epoch [s] where that is not the simulated time: in real time."""
        self._substeps = scenario.timing.physics_hz // scenario.timing.control_hz
        self._truth = measure_all(self._states, self._plants)
        self._odometry = self._truth
        self._plugins = WorldPlugins(scenario)
        self._around: list[VehicleDisturbances] = []
        if scenario.imperfect:
            self._odometry = self._truth.copy()
            for row, (uav_id, plant) in enumerate(zip(self.ids, plants, strict=True)):
                around = VehicleDisturbances(scenario, uav_id, plant.wind)
                self._odometry[row] = around.measured_odometry(0, self._truth[row])
                self._around.append(around)

    def begin_mission(self, tick: int) -> None:
        """The mission begins at this tick, from which faults are counted; it begins at 0 unless this is called."""
        for around in self._around:
            around.mission_tick = tick

    @property
    def tick(self) -> int:
        """Control periods that every vehicle has behind it."""
        return min(self.ticks.values())

    @property
    def t_ns(self) -> int:
        """Simulated time [ns]."""
        return self.tick * self._dt_ns

    def odometry(self, uav_id: int) -> Array:
        """Odometry vector (13,) that one UAV sees of itself now."""
        return self._odometry[self._row[uav_id]]

    def truth(self, uav_id: int) -> Array:
        """True odometry vector (13,) of one UAV now."""
        return self._truth[self._row[uav_id]]

    def _obstacles_now(self, tick: int) -> Array:
        """Obstacles (O, 20) at a tick, in real time at the time of the mission."""
        if not self._moving:
            return self._obstacles
        t = seconds(tick * self._dt_ns) if self.mission_s is None else self.mission_s
        return np.asarray(obstacle_rows(self._scenario, np.array([t]))[0])

    def obstacle_positions(self) -> Array:
        """Positions (O, 3) [m] of all obstacles now."""
        return self._obstacles_now(self.tick)[:, 0:3]

    def near(self, uav_id: int) -> Array:
        """Rows (M, 8) that the near-object sensor of one UAV sees now."""
        row, tick = self._row[uav_id], self.ticks[uav_id]
        seen = self._odometry[row] if self._around else None
        obstacles = self._obstacles_now(tick)
        return self._plugins.near(row, tick, self._truth, seen, obstacles, self._keep_outs)

    def with_late_setpoint(self, uav_id: int, wrench: Array) -> Array:
        """The wrench (6,) of a vehicle whose setpoint is late: its inner loop keeps the attitude."""
        row = self._row[uav_id]
        rates = self._truth[row][10:13]
        return keeping_attitude(wrench, rates, self._bodies[row], seconds(self._dt_ns))

    def step(self, wrenches: Mapping[int, Array]) -> None:
        """Advance all by one control period; a UAV without a wrench (6,) stays where it is, as in a hold failsafe."""
        for uav_id in self.ids:
            self.step_one(uav_id, wrenches.get(uav_id))

    def step_one(self, uav_id: int, wrench: Array | None) -> None:
        """Advance one vehicle by one control period: they meet nowhere but in the sensor and on the wire."""
        row, tick = self._row[uav_id], self.ticks[uav_id]
        if self._around:
            self._around[row].gust_step(tick)
        plugins = self._plugins
        if plugins.disturbance is not None:
            plant = plugins.disturbed(uav_id, tick, self._truth[row], self._plants[row])
            self._plants[row] = plant
        if plugins.plant is not None and wrench is not None:
            plugins.advance(self._states[row], wrench, tick, self._plants[row])
            self._truth[row] = measure_all(self._states, self._plants)[row]
        else:
            self._truth[row] = _advance_row(
                self._states,
                row,
                _NO_WRENCH if wrench is None else wrench,
                wrench is not None,
                seconds(tick * self._dt_ns),
                seconds(self._dt_ns),
                self._substeps,
                self._plants,
            )
        if self._around:
            self._odometry[row] = self._around[row].measured_odometry(tick + 1, self._truth[row])
        self.ticks[uav_id] = tick + 1
