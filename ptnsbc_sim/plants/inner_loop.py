"""The inner loop of a flight controller: it keeps the attitude while the setpoint is late."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.plants.contract import PlantConfig


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
    momentum = np.array(plant.inertia) * rates
    held = wrench.copy()
    held[3:6] = np.cross(rates, momentum) - momentum / (2.0 * max(period_s, plant.motor_lag_s))
    return held
