"""Samples over time, in memory or on the disk, read block by block.

A sum over more than one block is the sum of the blocks' sums. It is therefore the same whether the samples are
in memory or on the disk.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

BLOCK = 8192
"""Samples that are read together: 82 s at 100 Hz."""


def lengths(vectors: Array) -> Array:
    """Euclidean lengths (T,) of vectors (T, 3): the bits of `numpy.linalg.norm` in a third of its time."""
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z), dtype=np.float64)


def max_of(first: float, second: float) -> float:
    """The larger of two numbers, NaN when one of them is NaN."""
    return float(np.maximum(first, second))


class ValueAt:
    """The value of a curve at one time [s], interpolated; None while the curve ends before that time."""

    def __init__(self, t_s: float) -> None:
        self.value: float | None = None
        self._t_s = t_s
        self._last = (np.empty(0), np.empty(0))

    def add(self, times: Array, values: Array) -> None:
        """Take the next samples (T,) [s] and (T,)."""
        if self.value is None and times[-1] >= self._t_s:
            t, v = (np.concatenate(pair) for pair in zip(self._last, (times, values), strict=True))
            self.value = float(np.interp(self._t_s, t, v))
        self._last = times[-1:], values[-1:]


class Track(ABC):
    """Samples of one quantity of one UAV, ascending in time; at least one."""

    size: int  # number of samples
    first_ns: int  # stamp of the first sample
    last_ns: int  # stamp of the last sample

    @abstractmethod
    def index(self, t_ns: int, side: Literal["left", "right"]) -> int:
        """Number of samples before `t_ns`; with `right` those at `t_ns` too."""

    @abstractmethod
    def rows(self, first: int, end: int) -> Series:
        """Samples number `first` to `end - 1`."""

    def blocks(self, first: int = 0, end: int | None = None) -> Iterator[Series]:
        """Samples number `first` to `end - 1`, at most `BLOCK` at a time."""
        end = self.size if end is None else end
        for begin in range(first, end, BLOCK):
            yield self.rows(begin, min(begin + BLOCK, end))

    def span(self, first_ns: int, last_ns: int) -> tuple[int, int]:
        """The samples between two times, both included, as arguments of `blocks`."""
        return self.index(first_ns, "left"), self.index(last_ns, "right")

    def at(self, t_ns: NDArray[np.int64], width: int | None = None) -> Array:
        """Values at other times (T,), ascending: interpolated linearly, exact where the times coincide.

        `width`: only so many columns, from the first on.
        """
        first = max(self.index(int(t_ns[0]), "right") - 1, 0)
        end = max(min(self.index(int(t_ns[-1]), "left") + 1, self.size), first + 1)
        near = self.rows(first, end)
        values = near.values[:, :width]
        if np.array_equal(near.t_ns, t_ns):
            return values
        here = near.t_ns.searchsorted(t_ns).clip(max=near.size - 1)
        if np.array_equal(near.t_ns[here], t_ns):
            return values[here]
        base = near.t_ns[0]  # wall-clock stamps do not fit a float64 to the nanosecond
        own = (near.t_ns - base).astype(np.float64)
        wanted = (t_ns - base).astype(np.float64)
        return np.stack([np.interp(wanted, own, column) for column in values.T], axis=1)


class Series(Track):
    """Samples in memory."""

    def __init__(self, t_ns: NDArray[np.int64], values: Array) -> None:
        self.t_ns = t_ns  # (T,) ascending
        self.values = values  # (T, width)
        self.size = t_ns.size
        if self.size:
            self.first_ns, self.last_ns = int(t_ns[0]), int(t_ns[-1])

    def index(self, t_ns: int, side: Literal["left", "right"]) -> int:
        """Number of samples before `t_ns`; with `right` those at `t_ns` too."""
        return int(self.t_ns.searchsorted(t_ns, side))

    def rows(self, first: int, end: int) -> Series:
        """Samples number `first` to `end - 1`."""
        return Series(self.t_ns[first:end], self.values[first:end])
