"""From a scenario to its imperfections: for a whole flight at once, or for one vehicle at a time."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_sim.disturbances import gusts as wind
from ptnsbc_sim.disturbances import position_noise as position
from ptnsbc_sim.disturbances import random_streams, sensor_noise
from ptnsbc_sim.disturbances.gusts import Gusts, blow, gusts
from ptnsbc_sim.disturbances.links import last_heard
from ptnsbc_sim.disturbances.position_noise import (
    EXACT,
    PositionNoise,
    believed,
    no_error,
    odometer,
)
from ptnsbc_sim.disturbances.sensor_noise import SensorNoise, beside
from ptnsbc_sim.scenario import Scenario


def odometer_of(scenario: Scenario) -> PositionNoise:
    """The estimator of every UAV."""
    block = scenario.sensor.positioning
    if block is None:
        return EXACT
    return odometer(
        float(block.noise_m),
        float(block.acceleration_noise_m_s2),
        float(block.rate_hz),
        scenario.control_hz // block.rate_hz,
        round(block.latency_s * scenario.control_hz),
        round((block.latency_s - block.unknown_latency_s) * scenario.control_hz),
    )


def gusts_of(scenario: Scenario) -> Gusts:
    """The wind around every UAV."""
    world = scenario.file.world
    deviation = np.array(world.gust_m_s, dtype=np.float64)
    return gusts(scenario.wind_m_s, deviation, float(world.gust_time_s), scenario.dt_ns * 1e-9)


def sight_draws(scenario: Scenario, uav_id: int, tick: int) -> Array:
    """Standard normal numbers (6 objects,) for what one UAV sees near it at a tick."""
    address = (scenario.seed, random_streams.SIGHT, uav_id)
    return random_streams.normal(address, tick // scenario.near_every, _sight_width(scenario))


def _sight_width(scenario: Scenario) -> int:
    return sensor_noise.DRAWS * (len(scenario.uav_ids) - 1 + len(scenario.file.world.obstacles))


def sight_of(scenario: Scenario) -> SensorNoise:
    """The near-object sensor of every UAV."""
    return SensorNoise(float(scenario.sensor.noise_m), float(scenario.sensor.velocity_noise_m_s))


class Disturbances(NamedTuple):
    """Everything that goes wrong in one flight of T ticks and N UAVs; `errors` and `gust` change in place."""

    odometer: PositionNoise
    gusts: Gusts
    fixes: Array  # (T, N, 6) standard normal
    blows: Array  # (T, N, 3) standard normal
    heard: NDArray[np.int64]  # (T, N, 2 + K) tick of the newest message that came through, -1: none
    errors: Array  # (N, ...), a row of `odometer.no_error` each
    gust: Array  # (N, 3) [m/s]
    sights: Array  # (T / near_every, N, 6 objects) standard normal
    sight: SensorNoise


def chance(scenario: Scenario, neighbours: int) -> Disturbances | None:
    """The imperfections of a flight, None when there are none; `neighbours` is the width of the wiring."""
    if not scenario.imperfect:
        return None
    ids, ticks, seed = scenario.uav_ids, scenario.ticks, scenario.seed

    def table(kind: int, width: int, every: int = 1) -> Array:
        found = [
            random_streams.normals((seed, kind, uav), -(-ticks // every), width) for uav in ids
        ]
        return np.ascontiguousarray(np.stack(found, axis=1))

    kind = odometer_of(scenario)
    return Disturbances(
        kind,
        gusts_of(scenario),
        table(random_streams.ODOMETER, position.DRAWS),
        table(random_streams.GUST, wind.DRAWS),
        last_heard(scenario, neighbours),
        np.stack([no_error(kind)] * len(ids)),
        np.zeros((len(ids), wind.DRAWS)),
        table(random_streams.SIGHT, _sight_width(scenario), scenario.near_every),
        sight_of(scenario),
    )


class VehicleDisturbances:
    """The wind around one vehicle and what it believes of itself, tick by tick."""

    def __init__(self, scenario: Scenario, uav_id: int, wind_m_s: Array) -> None:
        """`wind_m_s` (3,) is the wind of its plant, changed in place."""
        self._scenario, self._uav = scenario, uav_id
        self._odometer = odometer_of(scenario)
        self._gusts = gusts_of(scenario)
        self._fixes = (scenario.seed, random_streams.ODOMETER, uav_id)
        self._blows = (scenario.seed, random_streams.GUST, uav_id)
        self._dt = scenario.dt_ns * 1e-9
        self._wind = wind_m_s
        self._gust = np.zeros(wind.DRAWS)
        self._error = no_error(self._odometer)
        self._past: deque[Array] = deque(maxlen=self._odometer.delay + 1)

    def blow(self, tick: int) -> None:
        """Set the wind of the control period that begins at `tick`."""
        draws = random_streams.normal(self._blows, tick, wind.DRAWS)
        blow(self._gust, self._wind, draws, tick, self._gusts)

    def believed(self, tick: int, truth: Array) -> Array:
        """Odometry vector (13,) that the UAV sees at `tick`; to be asked once a tick, in order."""
        self._past.append(truth[0:3].copy())
        draws, kind = random_streams.normal(self._fixes, tick, position.DRAWS), self._odometer
        reckoned = self._past[max(len(self._past) - 1 - kind.known, 0)]
        return believed(truth, self._past[0], reckoned, self._error, draws, tick, self._dt, kind)

    def beside(self, tick: int, near: Array, truth: Array, seen: Array) -> Array:
        """Near objects (M, 7) as it places them, from where they are and its true and believed odometry (13,)."""
        draws = sight_draws(self._scenario, self._uav, tick)
        return beside(near, truth, seen, draws, sight_of(self._scenario))
