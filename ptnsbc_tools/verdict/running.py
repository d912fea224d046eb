"""Figures of a formation error that arrives block by block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_tools.verdict.recording import NANO, Recording
from ptnsbc_tools.verdict.tolerances import SHARE_OF_START
from ptnsbc_tools.verdict.windows import encounters, inside

_EXACT_S = 1e-9
_NONE = np.empty(0)


class Instant:
    """The value of a curve at one time [s], linear in between; None while the curve ends before it."""

    def __init__(self, t_s: float) -> None:
        self.value: float | None = None
        self._t_s = t_s
        self._last = (_NONE, _NONE)

    def add(self, times: Array, values: Array) -> None:
        """Take (T,) [s] and (T,)."""
        if self.value is None and times[-1] >= self._t_s:
            t, v = (np.concatenate(pair) for pair in zip(self._last, (times, values), strict=True))
            self.value = float(np.interp(self._t_s, t, v))
        self._last = times[-1:], values[-1:]


class Settling:
    """When an error has left its band for the last time [s]; None when it ends outside."""

    def __init__(self) -> None:
        self.time: float | None = 0.0

    def add(self, times: Array, outside: NDArray[np.bool_]) -> None:
        """Take (T,) [s] and whether the error is outside there (T,)."""
        if self.time is None:
            self.time = float(times[0])
        found = np.flatnonzero(outside)
        if found.size:
            last = int(found[-1])
            self.time = float(times[last + 1]) if last + 1 < times.size else None


class ErrorFigures:
    """What is judged of the formation error of one UAV.

    Args:
        recording: the leg.
        uav: whose error.
        tolerance: hard limit at the deadline [m].
    """

    def __init__(self, recording: Recording, uav: int, tolerance: float) -> None:
        self._recording = recording
        self._deadline_s = deadline = recording.scenario.gains.formation.deadline_s
        self._windows = encounters(recording.scenario, recording.counters, uav)
        # What was under way at the deadline, or before it, excuses no late settling.
        start_ns = recording.start_ns
        self._later = [w for w in self._windows if (w[0] - start_ns) * NANO > deadline]
        self._tolerance = tolerance
        self._settling = Settling()
        self._at = Instant(deadline)
        self._last = _NONE  # time and error of the newest sample
        self._squares = 0.0  # sum of the squared errors after the deadline
        self._after = 0  # how many of them
        self.start_error = np.nan
        self.band = tolerance
        self.max_after: float | None = None
        self.encounter_s = 0.0
        self.avoiding: bool | None = None  # at the deadline; None before it
        self.not_finite_s: float | None = None

    def add(self, grid: NDArray[np.int64], error: Array) -> None:
        """Take errors (T,) [m] at (T,) [ns]."""
        times = self._recording.times(grid)
        if not self._last.size:
            self.start_error = float(error[0])
            self.band = max(self._tolerance, SHARE_OF_START * self.start_error)
        counted = ~inside(self._windows, grid)
        self._settling.add(times, (error > self.band) & ~inside(self._later, grid))
        self._at.add(times, error)
        self._take_after(times, error, counted)
        period = np.diff(times, prepend=self._last[:1])
        self.encounter_s += float(np.sum(period[~counted[-period.size :]]))
        bad = np.flatnonzero(~np.isfinite(error))
        if self.not_finite_s is None and bad.size:
            self.not_finite_s = float(times[bad[0]])
        self._last = np.array([times[-1], error[-1]])

    def _take_after(self, times: Array, error: Array, counted: NDArray[np.bool_]) -> None:
        reached = times >= self._deadline_s - _EXACT_S
        if self.avoiding is None and reached.any():
            self.avoiding = not counted[int(np.argmax(reached))]
        after = error[reached & counted]
        if after.size:
            largest = after.max() if self.max_after is None else max_of(self.max_after, after.max())
            self.max_after = float(largest)
            self._squares += float(np.sum(after**2))
            self._after += after.size

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return float(self._last[0])

    @property
    def settling_s(self) -> float | None:
        """When the error has left the band for the last time; None when it ends outside."""
        return self._settling.time

    @property
    def at_deadline(self) -> float | None:
        """The error at the deadline [m]; None when the leg ends before it."""
        if (
            self._at.value is None and self.avoiding is not None
        ):  # the last sample is at the deadline
            return float(self._last[1])
        return self._at.value

    @property
    def rmse_after(self) -> float | None:
        """Root mean square after the deadline, outside encounters."""
        return float(np.sqrt(self._squares / self._after)) if self._after else None


def max_of(first: float, second: float) -> float:
    """The larger of two, or what is no number among them."""
    return float(np.maximum(first, second))
