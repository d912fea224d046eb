"""Reaching functions of predefined-time control without a time base: x_dot = -phi(x) is zero before T, whatever x(0).

exponential:  phi(x) = exp(|x|^p) |x|^(1-p) sgn x / (p T)              reaches at T (1 - exp(-|x0|^p))
two-sided:    phi(x) = pi / (2 p T) (|x|^(1-p) + |x|^(1+p)) sgn x      reaches at T (2 / pi) atan(|x0|^p)
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.kernel import kernel

EXPONENTIAL, TWO_SIDED = 0, 1

FLOOR = 1e-3
"""Least |x| at which the slope of phi is evaluated [unit of x]; at zero it is infinite."""


class Reaching(NamedTuple):
    """One reaching function."""

    kind: int  # EXPONENTIAL or TWO_SIDED
    duration_s: float  # T [s]
    power: float  # p, 0 < p < 1; below 1/2 where the slope is used


@kernel
def phi(x: float, law: Reaching) -> float:
    """Rate at which x is driven to zero [unit/s]."""
    size = abs(x)
    if size == 0.0:
        return 0.0
    p = law.power
    if law.kind == EXPONENTIAL:
        rate = math.exp(size**p) * size ** (1.0 - p) / (p * law.duration_s)
    else:
        scale = math.pi / (2.0 * p * law.duration_s)
        rate = scale * (size ** (1.0 - p) + size ** (1.0 + p))
    return rate if x > 0.0 else -rate


@kernel
def slope(x: float, law: Reaching) -> float:
    """d phi / d x [1/s], with |x| floored."""
    size = max(abs(x), FLOOR)
    p = law.power
    if law.kind == EXPONENTIAL:
        return math.exp(size**p) * (p + (1.0 - p) * size**-p) / (p * law.duration_s)
    scale = math.pi / (2.0 * p * law.duration_s)
    return scale * ((1.0 - p) * size**-p + (1.0 + p) * size**p)
