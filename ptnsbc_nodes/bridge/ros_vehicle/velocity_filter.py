"""The velocity of a vehicle that reports its positions alone."""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.types import Array

TIME_CONSTANT_S, _FORGET_S = 0.025, 0.5  # after a longer gap it begins anew


class VelocityFilter:
    """A critically damped alpha-beta filter.

    With the time T between two positions and q = exp(-T / time constant), alpha is 1 - q^2 and beta (1 - q)^2. In a
    uniform acceleration its velocity is that of T (1 + 3 q) / (2 (1 - q)) before: two time constants for a small T.
    """

    def __init__(self) -> None:
        self._last: tuple[float, Array, Array] = (-math.inf, np.zeros(3), np.zeros(3))

    def update(self, sampled_s: float, position: Array) -> Array:
        """Velocity (3,) [m/s] at `position` (3,) [m]; an older position than the one before changes nothing."""
        last_s, expected, velocity = self._last
        step_s = sampled_s - last_s
        if step_s > _FORGET_S:
            self._last = (sampled_s, position, np.zeros(3))
        elif step_s > 0.0:
            kept = math.exp(-step_s / TIME_CONSTANT_S)
            expected = expected + step_s * velocity
            off = position - expected
            velocity = velocity + (1.0 - kept) ** 2 / step_s * off
            self._last = (sampled_s, expected + (1.0 - kept**2) * off, velocity)
        return self._last[2]
