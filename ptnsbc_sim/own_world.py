"""Plants, disturbances and near-object sensors of the user: what surrounds the controllers of a simulated flight.

The headless flight and the sim node call the same functions with the same numbers, so both give the same bits.
Nothing here runs when a bag is judged or re-run: the controllers start from what was recorded.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import NEAR_COLUMNS, ODOMETRY_SIZE, Array
from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.contract import STATE_SIZE, PlantConfig, Six, six
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sensor import near_objects
from ptnsbc_sim.user_file import UserFileError, UserFunction, place_of, shown, user_function

SAMPLES = 6
_NANO = 1e-9
_QUATERNION = slice(3, 7)


class DisturbanceInputs(NamedTuple):
    """The input of a disturbance at the start of a control period."""

    t: float  # [s] of the simulated world
    uav: int  # id
    odometry: (
        Array  # (13,) true: position [m, ENU], quaternion x y z w, velocity and rates of the body
    )
    samples: Array  # (6,) standard normal numbers of this UAV and tick, from the scenario's seed


class PlantInputs(NamedTuple):
    """The input of a plant at an instant."""

    t: float  # [s] of the simulated world
    state: Array  # (17,) position, quaternion x y z w, velocity [ENU], body rates, four numbers of its own
    wrench: Array  # (6,) commanded force [N] and torque [N m], body FLU
    push: Array  # (6,) acceleration of the disturbances [m/s^2, ENU], [rad/s^2, body]
    wind: Array  # (3,) [m/s, ENU]
    mass: float  # [kg] true
    inertia: Array  # (3,) [kg m^2] true
    gravity: float  # [m/s^2]
    max_thrust: float  # [N]
    max_torque: Array  # (3,) [N m]
    motor_lag_s: float
    drag: float  # [1/s]


class SensorInputs(NamedTuple):
    """The input of a near-object sensor at a reading. M: all other UAVs and all obstacles, at any distance."""

    t: float  # [s] of the simulated world
    uav: int  # id
    odometry: Array  # (13,) true
    objects: Array  # (M, 7) x y z [m], keep-out radius [m], vx vy vz [m/s, ENU]
    range_m: float  # of the scenario
    samples: Array  # (6,) standard normal numbers of this UAV and reading


_POSE = np.zeros(ODOMETRY_SIZE)
_EXAMPLES = {
    "disturbance": DisturbanceInputs(0.0, 1, _POSE, np.zeros(SAMPLES)),
    "plant": PlantInputs(
        0.0,
        np.zeros(STATE_SIZE),
        np.zeros(6),
        np.zeros(6),
        np.zeros(3),
        1.0,
        np.ones(3),
        9.81,
        1.0,
        np.ones(3),
        0.1,
        0.0,
    ),
    "sensor": SensorInputs(0.0, 1, _POSE, np.zeros((1, NEAR_COLUMNS)), 1.0, np.zeros(SAMPLES)),
}
"""Inputs with the types of all inputs."""


@lru_cache(maxsize=16)
def _load(kind: str, named: str) -> UserFunction:
    return user_function(named, kind, (_EXAMPLES[kind],))


class OwnWorld:
    """The functions of the user that a scenario names for its world; those that it does not name are None."""

    def __init__(self, scenario: Scenario) -> None:
        """Load the functions.

        Raises:
            UserFileError: one cannot be loaded, or the scenario comes from a bag.
        """
        self._scenario = scenario
        named = scenario.plugins

        def load(kind: str) -> UserFunction | None:
            return _load(kind, named.path_of(kind)) if getattr(named, kind) else None

        self._disturbance, self._plant, self._sensor = map(load, _EXAMPLES)
        self._dt = scenario.dt_ns * _NANO
        self._substeps = scenario.physics_hz // scenario.control_hz
        self.disturbs = self._disturbance is not None
        self.flies = self._plant is not None
        self.senses = self._sensor is not None

    @cached_property
    def _base(self) -> dict[int, Six]:
        """The constant acceleration that the scenario gives each UAV."""
        scenario = self._scenario
        return {uav: plant_config(scenario, uav).offset for uav in scenario.uav_ids}

    @classmethod
    def of(cls, scenario: Scenario) -> OwnWorld | None:
        """The functions of the world; None where the scenario names none."""
        return cls(scenario) if scenario.plugins.of_world else None

    def pushed(self, uav: int, tick: int, truth: Array, plant: PlantConfig) -> PlantConfig:
        """The plant with the disturbance of the control period that begins at `tick`; it replaces the one before.

        Args:
            uav: id.
            tick: control periods since the start of the simulated world.
            truth: true odometry vector (13,) at the tick.
            plant: the constants of the vehicle.

        Raises:
            UserFileError: the function raised an error, or did not return six finite numbers.
        """
        call = self._disturbance
        if call is None:
            return plant
        t = tick * self._scenario.dt_ns * _NANO
        inputs = DisturbanceInputs(t, uav, np.array(truth), self._samples(uav, 2 * tick))
        found = call.numbers(
            call(inputs),
            6,
            "six numbers: acceleration [m/s^2, ENU] and angular acceleration [rad/s^2, body]",
            f" at t = {t:.3f} s",
        )
        return plant._replace(
            offset=six(own + base for own, base in zip(found, self._base[uav], strict=True))
        )

    def _samples(self, uav: int, address: int) -> Array:
        """Standard normal numbers (6,); even addresses are the disturbance's, odd ones the sensor's."""
        stream = (self._scenario.seed, random_streams.OWN, uav)
        return np.array(random_streams.normal(stream, address, SAMPLES))

    def advance(self, state: Array, wrench: Array, tick: int, plant: PlantConfig) -> None:
        """State (17,) of a vehicle, in place, by one control period: Runge-Kutta of fourth order.

        Raises:
            UserFileError: the function raised an error, or did not return 17 finite numbers.
        """
        begin, step = tick * self._scenario.dt_ns * _NANO, self._dt / self._substeps
        for n in range(self._substeps):
            t, x = begin + n * step, np.array(state)
            first = self._rate(t, x, wrench, plant)
            second = self._rate(t + 0.5 * step, x + 0.5 * step * first, wrench, plant)
            third = self._rate(t + 0.5 * step, x + 0.5 * step * second, wrench, plant)
            fourth = self._rate(t + step, x + step * third, wrench, plant)
            x += step / 6.0 * (first + 2.0 * (second + third) + fourth)
            x[_QUATERNION] /= math.sqrt(sum(float(q) ** 2 for q in x[_QUATERNION]))
            state[:] = x

    def _rate(self, t: float, state: Array, wrench: Array, plant: PlantConfig) -> Array:
        call = self._plant
        assert call is not None
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
        at = f" at t = {t:.4f} s"
        return np.array(call.numbers(call(inputs), STATE_SIZE, "17 numbers, d state / dt", at))

    def near(
        self, row: int, tick: int, truth: Array, obstacles: Array, keep_outs: Array
    ) -> Array | None:
        """Rows (K, 7) that the sensor of UAV number `row` gives; None where it is ours.

        They are rounded to float32, as ours are.

        Args:
            row: of the observer.
            tick: of the reading.
            truth: true odometry vectors (N, 13) of all UAVs.
            obstacles: (O, 20) rows of bodies.
            keep_outs: (N,) keep-outs of the UAVs [m].

        Raises:
            UserFileError: the function raised an error, or gave no such rows.
        """
        call = self._sensor
        if call is None:
            return None
        scenario = self._scenario
        uav, t = scenario.uav_ids[row], tick * scenario.dt_ns * _NANO
        objects = near_objects(row, truth, obstacles, keep_outs, math.inf)
        reading = tick // scenario.near_every
        inputs = SensorInputs(
            t,
            uav,
            np.array(truth[row]),
            objects,
            float(scenario.sensor.range_m),
            self._samples(uav, 2 * reading + 1),
        )
        found = call(inputs)
        try:
            rows = np.asarray(found, dtype=np.float32).astype(np.float64)
        except (TypeError, ValueError):
            rows = np.zeros(0)
        if rows.size == 0 and len(np.shape(found)) >= 1:
            rows = np.zeros((0, NEAR_COLUMNS))
        right = rows.ndim == 2 and rows.shape[1] == NEAR_COLUMNS and len(rows) <= len(objects)
        if not right or not np.isfinite(rows).all():
            raise UserFileError(
                f"{place_of(call.function)}: returned {shown(found)} at t = {t:.3f} s: expected at most "
                f"{len(objects)} rows of 7 finite numbers"
            )
        return np.ascontiguousarray(rows)
