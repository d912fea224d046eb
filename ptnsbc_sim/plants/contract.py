"""Constants of a plant, and the disturbance that acts on every plant."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Array, Vector3

Six = tuple[float, float, float, float, float, float]


def six(vector: Iterable[float]) -> Six:
    """Six numbers as the kernels take them."""
    a, b, c, d, e, f = (float(number) for number in vector)
    return a, b, c, d, e, f


STATE_SIZE = 17
"""Size of a plant state; the last entries that a plant does not use are zero."""


class PlantConfig(NamedTuple):
    """Constants of one vehicle."""

    kind: int  # PLANT_*
    mass: float  # [kg]
    inertia: Vector3  # [kg m^2]
    gravity: float  # [m/s^2]
    max_thrust: float  # [N]
    max_torque: Vector3  # [N m]
    motor_lag_s: float  # first-order lag of thrust and torques; 0: none
    drag: float  # specific linear drag [1/s]
    wind: Array  # (3,) [m/s, ENU]
    amplitude: Six  # disturbance a sin(t + phase) + offset [m/s^2, rad/s^2]
    phase: Six  # [rad]
    offset: Six


class Waves(NamedTuple):
    """The sines of the disturbances at the instants of one control period: UAVs of equal phases share them."""

    sines: Array  # (2 substeps + 1, 6) at the start, middle and end of every substep
    phases: Array  # (6,) [rad] that they were computed for
    at: Array  # (1,) [s] start of the control period; NaN before the first


@inline_kernel
def no_waves(substeps: int) -> Waves:
    """Room for the sines of one control period, none of them computed yet."""
    return Waves(np.empty((2 * substeps + 1, 6)), np.empty(6), np.full(1, np.nan))


@inline_kernel
def _sines(phases: Six, t: float, out: Array) -> None:
    """sin(t + phase) of every axis into `out` (6,); axes of one phase share one sine."""
    for i in range(6):
        known = -1
        for j in range(i):
            if phases[j] == phases[i]:
                known = j
        out[i] = out[known] if known >= 0 else math.sin(t + phases[i])


@kernel
def _computed(waves: Waves, phases: Six, t: float, step: float) -> None:
    """The sines of the control period that begins at t [s] with substeps of `step` [s]."""
    waves.at[0] = t
    for i in range(6):
        waves.phases[i] = phases[i]
    _sines(phases, t, waves.sines[0])
    for n in range(waves.sines.shape[0] // 2):
        _sines(phases, t + (n + 0.5) * step, waves.sines[2 * n + 1])
        _sines(phases, t + (n + 1) * step, waves.sines[2 * n + 2])


@inline_kernel
def update_waves(waves: Waves, config: PlantConfig, t: float, step: float) -> None:
    """Have the sines of one vehicle in `waves` for the control period that begins at t [s]."""
    moving, known = False, waves.at[0] == t
    for i in range(6):
        moving = moving or config.amplitude[i] != 0.0
        known = known and waves.phases[i] == config.phase[i]
    if moving and not known:
        _computed(waves, config.phase, t, step)


@inline_kernel
def _disturbed(offset: float, amplitude: float, sine: float) -> float:
    return offset + amplitude * sine if amplitude != 0.0 else offset


@inline_kernel
def disturbance(config: PlantConfig, sines: Array, instant: int) -> Six:
    """Disturbance acceleration, linear [m/s^2] then angular [rad/s^2], at one instant of the `Waves` (Table 2)."""
    a, b = config.offset, config.amplitude
    return (
        _disturbed(a[0], b[0], sines[instant, 0]),
        _disturbed(a[1], b[1], sines[instant, 1]),
        _disturbed(a[2], b[2], sines[instant, 2]),
        _disturbed(a[3], b[3], sines[instant, 3]),
        _disturbed(a[4], b[4], sines[instant, 4]),
        _disturbed(a[5], b[5], sines[instant, 5]),
    )
