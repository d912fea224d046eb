"""Gusts: coloured noise around the mean wind, independent for each UAV.

First order with a correlation time, stationary from the start: the longitudinal form of Dryden's model, on all
three axes. Independent gusts are the hard case for a formation: a common gust would move all UAVs alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array

SAMPLES = 3
"""Random numbers per tick."""


class Gusts(NamedTuple):
    """Constants of the wind."""

    mean: Array  # (3,) [m/s, ENU]
    deviation: Array  # (3,) [m/s]
    decay: float  # factor of a gust from one control period to the next
    innovation: float  # factor of the deviation for the new noise


def gusts(mean: Array, deviation: Array, time_s: float, dt: float) -> Gusts:
    """Wind of mean (3,) and standard deviation (3,) [m/s], correlated over `time_s`, in steps of dt [s]."""
    decay = math.exp(-dt / time_s)
    return Gusts(mean, np.asarray(deviation, np.float64), decay, math.sqrt(1.0 - decay * decay))


@kernel
def gust_step(gust: Array, wind: Array, samples: Array, tick: int, kind: Gusts) -> None:
    """Gust (3,) and wind (3,) [m/s, ENU] of the control period that begins at `tick`, both in place."""
    for i in range(3):
        if tick == 0:
            gust[i] = kind.deviation[i] * samples[i]
        else:
            gust[i] = kind.decay * gust[i] + kind.innovation * kind.deviation[i] * samples[i]
        wind[i] = kind.mean[i] + gust[i]
