"""What a plant needs and what every plant offers."""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.types import Array

STATE_SIZE = 17
"""Rows of a plant state; a plant that needs fewer leaves the last ones at zero."""


class PlantConfig(NamedTuple):
    """Constants of one vehicle."""

    kind: int  # PLANT_*
    mass: float  # [kg]
    inertia: Array  # (3,) [kg m^2]
    gravity: float  # [m/s^2]
    max_thrust: float  # [N]
    max_torque: Array  # (3,) [N m]
    motor_lag_s: float  # first-order lag of thrust and torques; 0: none
    drag: float  # specific linear drag [1/s]
    wind: Array  # (3,) [m/s, ENU]
    amplitude: Array  # (6,) disturbance a sin(t + phase) + offset [m/s^2, rad/s^2]
    phase: Array  # (6,) [rad]
    offset: Array  # (6,)


@inline_kernel
def disturbance(config: PlantConfig, t: float, out: Array) -> None:
    """Disturbance acceleration at t [s] into `out` (6,): linear [m/s^2] then angular [rad/s^2] (Table 2)."""
    for i in range(6):
        out[i] = config.offset[i]
        if config.amplitude[i] != 0.0:
            out[i] += config.amplitude[i] * math.sin(t + config.phase[i])
