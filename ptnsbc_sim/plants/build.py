"""From a scenario to the plant of one UAV."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.signed_distance import BODY_COLUMNS
from ptnsbc_core.types import PLANT_RIGID_BODY, PLANTS, Array
from ptnsbc_sim.plants.contract import STATE_SIZE, PlantConfig, six
from ptnsbc_sim.plants.integrate import initial_state
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import three

_PHASES = {"sin": 0.0, "cos": np.pi / 2}


def plant_config(scenario: Scenario, uav_id: int) -> PlantConfig:
    """Constants of one vehicle, with its true mass and inertia. The 6-DOF body has no motors, as in the paper."""
    uav, vehicle = scenario.uav(uav_id), scenario.vehicle(uav_id)
    waves = (*uav.disturbance_m_s2, *uav.disturbance_rad_s2)
    kind = PLANTS[scenario.plant.kind]
    if kind == PLANT_RIGID_BODY:
        body = vehicle.rigid_body
        limits = (np.inf, (np.inf, np.inf, np.inf), 0.0, float(body.drag_1_s))
    else:
        quad = vehicle.rotor_limits
        torque = three(quad.max_torque_nm)
        limits = (float(quad.max_thrust_n), torque, float(quad.motor_lag_s), float(quad.drag_1_s))
    max_thrust, max_torque, lag, drag = limits
    return PlantConfig(
        kind,
        float(vehicle.mass_kg * uav.mass_scale),
        three(np.multiply(vehicle.inertia_kg_m2, uav.inertia_scale)),
        float(scenario.world.gravity_m_s2),
        max_thrust,
        max_torque,
        lag,
        drag,
        np.array(scenario.world.wind_m_s, dtype=np.float64),
        six(wave.amount if wave.shape in _PHASES else 0.0 for wave in waves),
        six(_PHASES.get(wave.shape, 0.0) for wave in waves),
        six(0.0 if wave.shape in _PHASES else wave.amount for wave in waves),
    )


def start_states(scenario: Scenario, plants: Sequence[PlantConfig]) -> Array:
    """Plant states (N, 17) at t = 0 of vehicles in a kernel list, in the order of the scenario's UAVs."""
    uavs = scenario.uavs
    positions = np.array([uav.position_m for uav in uavs], dtype=np.float64)
    attitudes = np.array([uav.attitude_rad for uav in uavs], dtype=np.float64)
    return _start_states(positions, attitudes, plants)


@kernel
def _start_states(positions: Array, attitudes: Array, plants: Sequence[PlantConfig]) -> Array:
    states = np.empty((positions.shape[0], STATE_SIZE))
    for row in range(positions.shape[0]):
        store(states[row], 0, initial_state(positions[row], attitudes[row], plants[row]))
    return states


def obstacle_rows(scenario: Scenario, times: Array) -> Array:
    """All obstacles at times (T,) [s] since the first epoch: rows of bodies (T, O, 20), (1, O, 20) where none moves."""
    obstacles = scenario.world.bodies
    if all(one.path is None for one in obstacles):
        times = times[:1]
    if not obstacles:
        return np.zeros((1, 0, BODY_COLUMNS))
    return np.ascontiguousarray(np.stack([one.rows(times) for one in obstacles], axis=1))
