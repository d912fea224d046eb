"""The start of a UAV: its pose, its disturbance, and how far the true vehicle is from the nominal one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.fields import Wave
from ptnsbc_sim.scenario.model import UavBlock

_PHASES = {"sin": 0.0, "cos": np.pi / 2}


class Disturbance(NamedTuple):
    """amplitudes * sin(t + phases) + offset, linear [m/s^2] then angular [rad/s^2]."""

    amplitudes: Array  # (6,)
    phases: Array  # (6,) [rad]
    offset: Array  # (6,)


class UavStart(NamedTuple):
    """One UAV's start."""

    id: int
    position: Array  # (3,) [m], ENU
    attitude: Array  # (3,) roll, pitch, yaw [rad]
    disturbance: Disturbance
    mass_scale: float  # true over nominal
    inertia_scale: Array  # (3,) true over nominal


def uav_start(block: UavBlock) -> UavStart:
    """The start of the UAV of one block of a file."""
    return UavStart(
        block.id,
        np.array(block.position_m, dtype=np.float64),
        np.array(block.attitude_rad, dtype=np.float64),
        _disturbance((*block.disturbance_m_s2, *block.disturbance_rad_s2)),
        float(block.mass_scale),
        np.array(block.inertia_scale, dtype=np.float64),
    )


def _disturbance(waves: tuple[Wave, ...]) -> Disturbance:
    periodic = [wave.amount if wave.shape in _PHASES else 0.0 for wave in waves]
    phases = [_PHASES.get(wave.shape, 0.0) for wave in waves]
    constant = [0.0 if wave.shape in _PHASES else wave.amount for wave in waves]
    return Disturbance(np.array(periodic), np.array(phases), np.array(constant))
