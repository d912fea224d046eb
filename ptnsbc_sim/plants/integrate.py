"""One control period of one vehicle: Runge-Kutta of fourth order at the physics rate."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_core.types import PLANT_RIGID_BODY, Array
from ptnsbc_sim.plants import quadrotor, rigid_body
from ptnsbc_sim.plants.contract import STATE_SIZE, PlantConfig, disturbance

rigid_derivative = rigid_body.derivative
quadrotor_derivative = quadrotor.derivative
quadrotor_normalise = quadrotor.normalise
rigid_odometry = rigid_body.odometry
quadrotor_odometry = quadrotor.odometry


@kernel
def initial_state(position: Array, euler: Array, config: PlantConfig) -> Array:
    """State (17,) at rest at `position` (3,) [m] with attitude `euler` (3,) [rad]; the motors carry the weight."""
    x = np.zeros(STATE_SIZE)
    x[0:3] = position
    if config.kind == PLANT_RIGID_BODY:
        x[3:6] = euler
        return x
    x[3:7] = quaternion_from_euler(euler)
    x[13] = config.mass * config.gravity
    return x


@kernel
def odometry(x: Array, config: PlantConfig) -> Array:
    """Odometry vector (13,) of a plant state (17,)."""
    if config.kind == PLANT_RIGID_BODY:
        return rigid_odometry(x)
    return quadrotor_odometry(x)


@kernel
def _derivative(x: Array, wrench: Array, push: Array, config: PlantConfig, out: Array) -> None:
    if config.kind == PLANT_RIGID_BODY:
        rigid_derivative(x, wrench, push, config, out)
    else:
        quadrotor_derivative(x, wrench, push, config, out)


@kernel
def advance(
    x: Array, wrench: Array, t: float, dt: float, substeps: int, config: PlantConfig
) -> Array:
    """State (17,) after one control period dt [s] from t [s] under a held wrench (6,)."""
    out = x.copy()
    k1, k2 = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    k3, k4 = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    mid = np.empty(STATE_SIZE)
    step = dt / substeps
    start = disturbance(config, t)
    for n in range(substeps):
        half = disturbance(config, t + (n + 0.5) * step)
        end = disturbance(config, t + (n + 1) * step)
        _derivative(out, wrench, start, config, k1)
        for i in range(STATE_SIZE):
            mid[i] = out[i] + 0.5 * step * k1[i]
        _derivative(mid, wrench, half, config, k2)
        for i in range(STATE_SIZE):
            mid[i] = out[i] + 0.5 * step * k2[i]
        _derivative(mid, wrench, half, config, k3)
        for i in range(STATE_SIZE):
            mid[i] = out[i] + step * k3[i]
        _derivative(mid, wrench, end, config, k4)
        for i in range(STATE_SIZE):
            out[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        if config.kind != PLANT_RIGID_BODY:
            quadrotor_normalise(out)
        start = end
    return out
