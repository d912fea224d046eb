"""One control period of one vehicle: Runge-Kutta of fourth order at the physics rate."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import inline_kernel, kernel
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
    store(x, 0, position)
    if config.kind == PLANT_RIGID_BODY:
        store(x, 3, euler)
        return x
    store(x, 3, quaternion_from_euler(euler))
    x[13] = config.mass * config.gravity
    return x


@inline_kernel
def odometry(x: Array, config: PlantConfig) -> Array:
    """Odometry vector (13,) of a plant state (17,)."""
    if config.kind == PLANT_RIGID_BODY:
        return rigid_odometry(x)
    return quadrotor_odometry(x)


@inline_kernel
def _derivative(x: Array, wrench: Array, push: Array, config: PlantConfig, out: Array) -> None:
    if config.kind == PLANT_RIGID_BODY:
        rigid_derivative(x, wrench, push, config, out)
    else:
        quadrotor_derivative(x, wrench, push, config, out)


@kernel
def advance(
    out: Array, wrench: Array, t: float, dt: float, substeps: int, config: PlantConfig
) -> None:
    """State `out` (17,), in place, by one control period dt [s] from t [s] under a held wrench (6,)."""
    slopes = np.empty((4, STATE_SIZE))
    mid = np.empty(STATE_SIZE)
    push = np.empty((3, 6))  # at the start, middle and end of a substep
    step = dt / substeps
    disturbance(config, t, push[0])
    for n in range(substeps):
        disturbance(config, t + (n + 0.5) * step, push[1])
        disturbance(config, t + (n + 1) * step, push[2])
        _derivative(out, wrench, push[0], config, slopes[0])
        for i in range(STATE_SIZE):
            mid[i] = out[i] + 0.5 * step * slopes[0, i]
        _derivative(mid, wrench, push[1], config, slopes[1])
        for i in range(STATE_SIZE):
            mid[i] = out[i] + 0.5 * step * slopes[1, i]
        _derivative(mid, wrench, push[1], config, slopes[2])
        for i in range(STATE_SIZE):
            mid[i] = out[i] + step * slopes[2, i]
        _derivative(mid, wrench, push[2], config, slopes[3])
        for i in range(STATE_SIZE):
            middle = slopes[1, i] + slopes[2, i]
            out[i] += step / 6.0 * (slopes[0, i] + 2.0 * middle + slopes[3, i])
        if config.kind != PLANT_RIGID_BODY:
            quadrotor_normalise(out)
        store(push[0], 0, push[2])
