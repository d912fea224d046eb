"""The response of a vehicle to the velocities that were wanted of it: gain and lag, from the flight itself."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array

_PERIOD_S = 0.05
_SPAN_S, _LEAST_SPAN_S = 30.0, 10.0
_MOST_LAG_S = 1.0
_GAIN_OFF, _LAG_OFF_S = (
    0.3,
    0.3,
)  # farther from what was wanted, the prediction does not fit the vehicle
_LEAST_M_S = 0.1  # root of the mean square of what was wanted about its mean: less shows nothing


class Following(NamedTuple):
    """Gain and lag of one vehicle."""

    gain: float
    lag_s: float

    @property
    def unlike(self) -> str:
        """A sentence on gain and lag that are too far from 1 and 0 s; empty when both are near enough."""
        if abs(self.gain - 1.0) <= _GAIN_OFF and self.lag_s <= _LAG_OFF_S:
            return ""
        return (
            f"flies the wanted velocities with gain {self.gain:.2f}, {self.lag_s:.2f} s late: expected "
            f"{1.0 - _GAIN_OFF:g} to {1.0 + _GAIN_OFF:g} and at most {_LAG_OFF_S:g} s; ptnsbc tune finds what fits"
        )


class FollowingEstimator:
    """Compares the last half minute of wanted and flown horizontal velocities, sampled 20 times a second."""

    def __init__(self) -> None:
        # One row per sample: the thread of the node reads what the thread of the bridge appends.
        self._rows: deque[Array] = deque(maxlen=round(_SPAN_S / _PERIOD_S))
        self._next_s = 0.0

    def restart(self) -> None:
        """Forget everything: what follows has another setpoint."""
        self._rows.clear()

    def add(self, now_s: float, wanted: Array, flown: Array) -> None:
        """Take the wanted and the flown velocity (3,) [m/s] of now."""
        if now_s < self._next_s:
            return
        if now_s > self._next_s + 2.0 * _PERIOD_S:
            self.restart()
            self._next_s = now_s
        self._next_s += _PERIOD_S
        self._rows.append(np.concatenate((wanted[0:2], flown[0:2])))

    def found(self) -> Following | None:
        """The lag at which gain times what was wanted fits best what was flown; None while too little has moved."""
        rows = list(self._rows)
        if len(rows) < _LEAST_SPAN_S / _PERIOD_S:
            return None
        wanted, flown = np.array(rows)[:, 0:2], np.array(rows)[:, 2:4]
        best: tuple[float, Following] | None = None
        for steps in range(round(_MOST_LAG_S / _PERIOD_S) + 1):
            before = wanted[: len(wanted) - steps]
            before = before - before.mean(axis=0)
            after = flown[steps:] - flown[steps:].mean(axis=0)
            power = float(np.sum(before * before))
            if power < len(before) * _LEAST_M_S**2:
                return None
            gain = float(np.sum(before * after)) / power
            left = float(np.mean((after - gain * before) ** 2))
            if best is None or left < best[0]:
                best = (left, Following(gain, steps * _PERIOD_S))
        return None if best is None else best[1]
