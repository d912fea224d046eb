"""Samples over time, in memory or in a file that is mapped, read block by block.

A sum over more than one block is the sum of the blocks' sums. It is therefore the same whether the samples are
in memory or on the disk.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

BLOCK = 8192
"""Samples that are read together: 82 s at 100 Hz."""


def lengths(vectors: Array) -> Array:
    """Euclidean lengths (...) of vectors (3, ...): the bits of `numpy.linalg.norm` in a third of its time."""
    x, y, z = vectors
    square = x * x
    square += y * y  # in place: a third array of this size costs as much as the sum
    square += z * z
    return np.asarray(np.sqrt(square), dtype=np.float64)


def max_of(first: float | None, second: float) -> float:
    """The larger of two numbers, NaN when one of them is NaN; the second where there is no first."""
    return float(second if first is None else np.maximum(first, second))


class ValueAt:
    """The value of a curve at one time [s], interpolated; None while the curve ends before that time."""

    def __init__(self, t_s: float) -> None:
        self.value: float | None = None
        self._t_s = t_s
        self._last: tuple[float, float] | None = None

    def add(self, times: Array, values: Array) -> None:
        """Take the next samples (T,) [s] and (T,)."""
        if self.value is None and times[-1] >= self._t_s:
            after = int(times.searchsorted(self._t_s))
            if after:
                self._last = float(times[after - 1]), float(values[after - 1])
            t, self.value = float(times[after]), float(values[after])
            if self._last is not None and t > self._t_s:
                slope = (self.value - self._last[1]) / (t - self._last[0])
                self.value = slope * (self._t_s - self._last[0]) + self._last[1]
        self._last = float(times[-1]), float(values[-1])


class Track:
    """Samples of one quantity of a UAV, or of several UAVs at the same stamps, ascending in time; at least one."""

    def __init__(self, t_ns: NDArray[np.int64], values: Array) -> None:
        self.t_ns = t_ns  # (T,) ascending
        self.values = values  # (T, width), of several UAVs (T, N, width)
        self.size: int = t_ns.size
        if self.size:
            self.first_ns, self.last_ns = int(t_ns[0]), int(t_ns[-1])

    def index(self, t_ns: int, side: Literal["left", "right"]) -> int:
        """Number of samples before `t_ns`; with `right` those at `t_ns` too."""
        return int(self.t_ns.searchsorted(t_ns, side))

    def rows(self, first: int, end: int) -> Track:
        """Samples number `first` to `end - 1`."""
        return Track(self.t_ns[first:end], self.values[first:end])

    def blocks(self, first: int = 0, end: int | None = None) -> Iterator[Track]:
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
        stamps, values = self.t_ns[first:end], self.values[first:end, ..., :width]
        if stamps.size == t_ns.size and (stamps == t_ns).all():
            return values
        here = np.minimum(stamps.searchsorted(t_ns), stamps.size - 1)
        if (stamps[here] == t_ns).all():
            return values[here]
        base = stamps[0]  # wall-clock stamps do not fit a float64 to the nanosecond
        own = (stamps - base).astype(np.float64)
        wanted = (t_ns - base).astype(np.float64)
        columns = values.reshape(len(values), -1).T
        between = np.stack([np.interp(wanted, own, column) for column in columns], axis=1)
        return between.reshape(-1, *values.shape[1:])


class Together(Mapping[int, Track]):
    """The tracks of UAVs that sampled at the same stamps: views of one track, which is reduced as a whole."""

    def __init__(self, uavs: Sequence[int], track: Track) -> None:
        self._rows = {uav: row for row, uav in enumerate(uavs)}
        self.track = track  # values (T, N, width)

    def __getitem__(self, uav: int) -> Track:
        return Track(self.track.t_ns, self.track.values[:, self._rows[uav]])

    def __iter__(self) -> Iterator[int]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


def together(tracks: Mapping[int, Track]) -> list[tuple[tuple[int, ...], Track]]:
    """The UAVs that sampled at the same stamps, and their samples as one track with values (T, N, width)."""
    if isinstance(tracks, Together):
        return [(tuple(tracks), tracks.track)]
    return [((uav,), Track(track.t_ns, track.values[:, None])) for uav, track in tracks.items()]


def vectors_at(
    tracks: Mapping[int, Track], uavs: Sequence[int], stamps: NDArray[np.int64]
) -> Array:
    """The first three columns of the tracks of UAVs at instants (T,) [ns], ascending: (3, N, T), axis by axis."""
    vectors = np.empty((3, len(uavs), stamps.size))
    for group, track in together(tracks):
        values = track.at(stamps, 3).T
        for row, uav in enumerate(group):
            if uav in uavs:
                vectors[:, uavs.index(uav)] = values[:, row]
    return vectors
