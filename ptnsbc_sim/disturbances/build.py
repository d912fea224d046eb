"""From a scenario to its disturbances: for a whole flight at once, or for one vehicle at a time."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.disturbances.faults import add_jumps, gone, jumps_of
from ptnsbc_sim.disturbances.links import last_received
from ptnsbc_sim.disturbances.noise import (
    GUST_SAMPLES,
    POSITION_SAMPLES,
    SENSOR_SAMPLES,
    Gusts,
    PositionNoise,
    SensorNoise,
    gust_step,
    gusts_of,
    initial_error,
    measured_odometry,
    position_noise_of,
    sensor_noise_of,
)
from ptnsbc_sim.scenario import Scenario


def sensor_noise_samples(scenario: Scenario, uav_id: int, tick: int) -> Array:
    """Standard normal numbers (6 objects,) for the near-object sensor of one UAV at a tick."""
    address, reading = (scenario.seed, random_streams.SENSOR, uav_id), tick // scenario.near_every
    return random_streams.normal(address, reading, _sensor_sample_count(scenario))


def _sensor_sample_count(scenario: Scenario) -> int:
    return SENSOR_SAMPLES * (len(scenario.uav_ids) - 1 + len(scenario.world.bodies))


class Disturbances(NamedTuple):
    """Disturbances of a flight of T ticks and N UAVs; `position_errors` and `gust` change in place."""

    position_noise: PositionNoise
    gusts: Gusts
    position_samples: Array  # (T, N, 6) standard normal
    gust_samples: Array  # (T, N, 3) standard normal
    received: NDArray[np.int64]  # (T, N, 2 + K) tick of the newest message received, -1: none
    position_errors: Array  # (N, ...), a row of `initial_error` each
    gust: Array  # (N, 3) [m/s]
    sensor_samples: Array  # (T / near_every, N, 6 objects) standard normal
    sensor_noise: SensorNoise
    jumps: Array  # (J, 6) as `jumps_of` has them
    gone: NDArray[np.bool_]  # (T, N) whether the UAV's process is dead


def flight_disturbances(scenario: Scenario, neighbours: int) -> Disturbances | None:
    """The disturbances of a flight, None without any; `neighbours` is the width of the wiring."""
    if not scenario.imperfect:
        return None
    ids, ticks, seed = scenario.uav_ids, scenario.timing.ticks, scenario.seed

    def table(kind: int, width: int, every: int = 1) -> Array:
        count = -(-ticks // every)
        rows = [random_streams.first_numbers((seed, kind, uav), count, width) for uav in ids]
        return np.ascontiguousarray(np.stack(rows, axis=1))

    kind = position_noise_of(scenario)
    return Disturbances(
        kind,
        gusts_of(scenario),
        table(random_streams.POSITION, POSITION_SAMPLES),
        table(random_streams.GUST, GUST_SAMPLES),
        last_received(scenario, neighbours),
        np.stack([initial_error(kind)] * len(ids)),
        np.zeros((len(ids), GUST_SAMPLES)),
        table(random_streams.SENSOR, _sensor_sample_count(scenario), scenario.near_every),
        sensor_noise_of(scenario),
        jumps_of(scenario),
        gone(scenario),
    )


class VehicleDisturbances:
    """The wind around one vehicle and its measurements, tick by tick."""

    def __init__(self, scenario: Scenario, uav_id: int, wind_m_s: Array) -> None:
        """`wind_m_s` (3,) is the wind of its plant, changed in place."""
        self._position_noise = position_noise_of(scenario)
        self._gusts = gusts_of(scenario)
        self._position_address = (scenario.seed, random_streams.POSITION, uav_id)
        self._gust_address = (scenario.seed, random_streams.GUST, uav_id)
        self._dt = seconds(scenario.timing.dt_ns)
        self._wind = wind_m_s
        self._gust = np.zeros(GUST_SAMPLES)
        self._error = initial_error(self._position_noise)
        self._row = scenario.uav_ids.index(uav_id)
        self._jumps = jumps_of(scenario)
        self.mission_tick = 0
        """The tick at which the mission began, from which faults are counted."""
        self._past: deque[Array] = deque(maxlen=self._position_noise.delay + 1)

    def gust_step(self, tick: int) -> None:
        """Set the wind of the control period that begins at `tick`."""
        samples = random_streams.normal(self._gust_address, tick, GUST_SAMPLES)
        gust_step(self._gust, self._wind, samples, tick, self._gusts)

    def measured_odometry(self, tick: int, truth: Array) -> Array:
        """Measured odometry vector (13,) at `tick`; call it once per tick, in order."""
        self._past.append(truth[0:3].copy())
        kind = self._position_noise
        samples = random_streams.normal(self._position_address, tick, POSITION_SAMPLES)
        compensated = self._past[max(len(self._past) - 1 - kind.compensated, 0)]
        measured = measured_odometry(
            truth, self._past[0], compensated, self._error, samples, tick, self._dt, kind
        )
        add_jumps(measured, tick - self.mission_tick, self._row, self._jumps)
        return measured
