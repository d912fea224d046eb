"""The plug-ins of the simulated world: plants, disturbances and near-object sensors.

The headless flight and the sim node call the same functions with the same numbers, so both give the same bits.
Nothing here runs when a bag is judged or re-run: the controllers start from what was recorded.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import NEAR_COLUMNS, Array
from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.disturbances.build import sensor_noise_samples
from ptnsbc_sim.disturbances.noise import add_sensor_noise, sensor_noise_of
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.contract import PlantConfig, Six, six
from ptnsbc_sim.plugins.hooks import SAMPLES, DisturbanceInputs, PlantInputs, SensorInputs
from ptnsbc_sim.plugins.loader import Plugin, load_plugin
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects

_QUATERNION = slice(3, 7)


class WorldPlugins:
    """The plug-ins that a scenario names for its world; those that it does not name are None.

    PluginError when one cannot be loaded, as of a bag, and when a function fails or gives no such numbers.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.disturbance, self.plant, self.sensor = (
            load_plugin(name, named) if (named := getattr(scenario.plugins, name)) else None
            for name in ("disturbance", "plant", "sensor")
        )

    @cached_property
    def _base(self) -> dict[int, Six]:
        """The constant acceleration that the scenario gives each UAV."""
        scenario = self._scenario
        return {uav: plant_config(scenario, uav).offset for uav in scenario.uav_ids}

    def _seconds(self, tick: int) -> float:
        return seconds(tick * self._scenario.timing.dt_ns)

    def _samples(self, uav: int, address: int) -> Array:
        """Standard normal numbers (6,); even addresses are the disturbance's, odd ones the sensor's."""
        stream = (self._scenario.seed, random_streams.OWN, uav)
        return np.array(random_streams.normal(stream, address, SAMPLES))

    def disturbed(self, uav: int, tick: int, truth: Array, plant: PlantConfig) -> PlantConfig:
        """The plant with the disturbance of the control period that begins at `tick`; it replaces the one before.

        `tick` counts the control periods of the simulated world; `truth` (13,) is the true odometry vector at it.
        """
        assert self.disturbance is not None
        t = self._seconds(tick)
        inputs = DisturbanceInputs(t, uav, np.array(truth), self._samples(uav, 2 * tick))
        push = self.disturbance.numbers(inputs, at=f"t = {t:.3f} s")
        return plant._replace(
            offset=six(added + base for added, base in zip(push, self._base[uav], strict=True))
        )

    def advance(self, state: Array, wrench: Array, tick: int, plant: PlantConfig) -> None:
        """State (17,) of a vehicle, in place, by one control period: Runge-Kutta of fourth order."""
        substeps = self._scenario.timing.physics_hz // self._scenario.timing.control_hz
        begin, step = self._seconds(tick), seconds(self._scenario.timing.dt_ns) / substeps
        for n in range(substeps):
            t, x = begin + n * step, np.array(state)
            first = self._rate(t, x, wrench, plant)
            second = self._rate(t + 0.5 * step, x + 0.5 * step * first, wrench, plant)
            third = self._rate(t + 0.5 * step, x + 0.5 * step * second, wrench, plant)
            fourth = self._rate(t + step, x + step * third, wrench, plant)
            x += step / 6.0 * (first + 2.0 * (second + third) + fourth)
            x[_QUATERNION] /= math.sqrt(sum(float(q) ** 2 for q in x[_QUATERNION]))
            state[:] = x

    def _rate(self, t: float, state: Array, wrench: Array, plant: PlantConfig) -> Array:
        assert self.plant is not None
        push = [
            offset + (amplitude * math.sin(t + phase) if amplitude else 0.0)
            for offset, amplitude, phase in zip(
                plant.offset, plant.amplitude, plant.phase, strict=True
            )
        ]
        inputs = PlantInputs(
            t,
            state,
            np.array(wrench),
            np.array(push),
            np.array(plant.wind),
            plant.mass,
            np.array(plant.inertia),
            plant.gravity,
            plant.max_thrust,
            np.array(plant.max_torque),
            plant.motor_lag_s,
            plant.drag,
        )
        return np.array(self.plant.numbers(inputs, at=f"t = {t:.4f} s"))

    def near(
        self,
        row: int,
        tick: int,
        truth: Array,
        seen: Array | None,
        obstacles: Array,
        keep_outs: Array,
    ) -> Array:
        """Rows (K, 8) that the sensor of UAV number `row` gives, ours or the one that is plugged in.

        With `seen`, the odometry (13,) that the UAV measures, they have the errors of sensor and position.

        `truth` (N, 13), `obstacles` (O, 20) and `keep_outs` (N, 2) are as in `near_objects`.
        """
        scenario = self._scenario
        if self.sensor is None:
            range_m = float(scenario.sensor.range_m)
            rows = near_objects(row, truth, obstacles, keep_outs, range_m)
        else:
            objects = near_objects(row, truth, obstacles, keep_outs, math.inf)
            rows = self._sensed(self.sensor, scenario.uav_ids[row], tick, truth[row], objects)
        if seen is None:
            return rows
        samples = sensor_noise_samples(scenario, scenario.uav_ids[row], tick)
        return add_sensor_noise(rows, truth[row], seen, samples, sensor_noise_of(scenario))

    def _sensed(self, sensor: Plugin, uav: int, tick: int, truth: Array, objects: Array) -> Array:
        """Rows (K, 8) that the sensor of the user gives of all objects (M, 8)."""
        scenario, t = self._scenario, self._seconds(tick)
        samples = self._samples(uav, 2 * (tick // scenario.near_every) + 1)
        range_m = float(scenario.sensor.range_m)
        seen = sensor.result(SensorInputs(t, uav, np.array(truth), objects, range_m, samples))
        try:
            rows = np.asarray(seen, dtype=np.float64)
        except (TypeError, ValueError):
            rows = np.zeros(0)
        if rows.size == 0 and len(np.shape(seen)) >= 1:
            rows = np.zeros((0, NEAR_COLUMNS))
        fits = rows.ndim == 2 and rows.shape[1] == NEAR_COLUMNS and len(rows) <= len(objects)
        if not fits or not np.isfinite(rows).all():
            raise sensor.refusal(
                seen, f"expected at most {len(objects)} {sensor.hook.gives}, at t = {t:.3f} s"
            )
        return np.ascontiguousarray(rows)
