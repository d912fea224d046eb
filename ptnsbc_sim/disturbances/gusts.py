"""Gusts: coloured noise around the mean wind, for each UAV its own.

First order with a correlation time, stationary from the start: the longitudinal form of Dryden's model, on
all three axes. Independent gusts are the hard case for a formation; those of one field would push all
UAVs alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array

DRAWS = 3
"""Random numbers per tick."""


class Gusts(NamedTuple):
    """Constants of the wind."""

    mean: Array  # (3,) [m/s, ENU]
    deviation: Array  # (3,) [m/s]
    keep: float  # what is left of a gust after one control period
    renew: float  # share of the deviation that is new


def gusts(mean: Array, deviation: Array, time_s: float, dt: float) -> Gusts:
    """Wind of mean (3,) and standard deviation (3,) [m/s], correlated over `time_s`, in steps of dt [s]."""
    keep = math.exp(-dt / time_s)
    return Gusts(mean, np.asarray(deviation, np.float64), keep, math.sqrt(1.0 - keep * keep))


@kernel
def blow(gust: Array, wind: Array, draws: Array, tick: int, kind: Gusts) -> None:
    """Gust (3,) and wind (3,) [m/s, ENU] of the control period that begins at `tick`, both in place."""
    for i in range(3):
        if tick == 0:
            gust[i] = kind.deviation[i] * draws[i]
        else:
            gust[i] = kind.keep * gust[i] + kind.renew * kind.deviation[i] * draws[i]
        wind[i] = kind.mean[i] + gust[i]
