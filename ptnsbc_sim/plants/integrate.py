"""One control period of one vehicle, by Runge-Kutta of fourth order; its start, and its inner loop."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_core.types import ODOMETRY_SIZE, PLANT_RIGID_BODY, Array
from ptnsbc_sim.plants import quadrotor, rigid_body
from ptnsbc_sim.plants.contract import STATE_SIZE, PlantConfig, Waves, no_waves, update_waves


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
def store_odometry(out: Array, x: Array, kind: int) -> None:
    """Odometry vector of a plant state (17,) into `out` (13,)."""
    if kind == PLANT_RIGID_BODY:
        rigid_body.store_odometry(out, x)
    else:
        quadrotor.store_odometry(out, x)


@inline_kernel
def stop(x: Array, kind: int) -> None:
    """Bring a plant state (17,) to rest where it is, in place."""
    if kind == PLANT_RIGID_BODY:
        for i in range(6, 12):
            x[i] = 0.0
    else:
        for i in range(7, 13):
            x[i] = 0.0


@kernel
def odometry(x: Array, config: PlantConfig) -> Array:
    """Odometry vector (13,) of a plant state (17,)."""
    out = np.empty(ODOMETRY_SIZE)
    store_odometry(out, x, config.kind)
    return out


@kernel
def advance_with(
    out: Array, wrench: Array, t: float, dt: float, config: PlantConfig, waves: Waves
) -> None:
    """As `advance`, with the sines of this control period kept in `waves` for the next vehicle."""
    step = dt / (waves.sines.shape[0] // 2)
    update_waves(waves, config, t, step)
    if config.kind == PLANT_RIGID_BODY:
        rigid_body.advance(out, wrench, step, config, waves.sines)
    else:
        quadrotor.advance(out, wrench, step, config, waves.sines)


@kernel
def advance(
    out: Array, wrench: Array, t: float, dt: float, substeps: int, config: PlantConfig
) -> None:
    """State `out` (17,), in place, by one control period dt [s] from t [s] under a held wrench (6,)."""
    advance_with(out, wrench, t, dt, config, no_waves(substeps))


def keeping_attitude(wrench: Array, rates: Array, plant: PlantConfig, period_s: float) -> Array:
    """A wrench (6,) with the force of `wrench`, and with torques that end the rotation.

    The rates decay with twice the control period, or twice the lag of the motors where that is longer: then they and
    the motors together are damped by 0.7.

    Args:
        wrench: The newest one (6,), body axes [N, N m].
        rates: Of the body (3,) [rad/s].
        plant: Has inertia and motors.
        period_s: Length of a control period [s].
    """
    # In floats: the sim does this for all vehicles at once, when the computer has no time.
    p, q, r = rates.tolist()
    x, y, z = (inertia * rate for inertia, rate in zip(plant.inertia, (p, q, r), strict=True))
    decay_s = 2.0 * max(period_s, plant.motor_lag_s)
    held = wrench.copy()
    held[3:6] = (
        q * z - r * y - x / decay_s,
        r * x - p * z - y / decay_s,
        p * y - q * x - z / decay_s,
    )
    return held
