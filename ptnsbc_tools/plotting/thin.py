"""Fewer points for the same curve: every peak keeps its height and its time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

_IN_MEMORY = 20_000  # points of a curve; no figure shows more

Key = TypeVar("Key", bound=Hashable)


class Points(NamedTuple):
    """Samples of one quantity."""

    t: Array  # (P,) [s]
    values: Array  # (P,)


class Thinner:
    """Reduces a curve that arrives block by block to the extremes of each of many spans.

    A span that has NaN or infinity in it keeps the first of these too, so that a gap stays a gap.

    Args:
        total: samples that will arrive.
        points: largest number of points that are kept, at least 8.
    """

    def __init__(self, total: int, points: int = _IN_MEMORY) -> None:
        self._short = total <= points
        self._edges = np.linspace(0, total, max((points - 2) // 3, 2) + 1).astype(np.int64)
        self._total = total
        self._taken = 0  # samples of complete spans
        self._open = Points(np.empty(0), np.empty(0))  # samples of the incomplete span
        self._parts: list[Points] = []

    def add(self, t: Array, values: Array) -> None:
        """Take the next samples (T,) [s] and (T,), ascending."""
        if self._short:
            self._parts.append(Points(t, values))
            return
        held = Points(np.append(self._open.t, t), np.append(self._open.values, values))
        seen = self._taken + held.t.size
        first, last = np.searchsorted(self._edges, (self._taken, seen), side="right") - 1
        done = int(self._edges[last]) - self._taken
        if done:
            kept = _extremes(held.values, self._edges[first : last + 1] - self._taken)
            # Both ends of the curve are kept too.
            kept |= {0} if self._taken == 0 else set()
            kept |= {done - 1} if seen == self._total else set()
            chosen = np.array(sorted(kept), dtype=np.int64)
            self._parts.append(Points(held.t[chosen], held.values[chosen]))
        self._open = Points(held.t[done:], held.values[done:])
        self._taken += done

    def points(self) -> Points:
        """The points that are kept."""
        t, values = zip(*self._parts, strict=True)
        return Points(np.concatenate(t), np.concatenate(values))


class ThinnedCurves(Generic[Key]):
    """Thinned curves by key; `total` samples will arrive of each."""

    def __init__(self, total: int) -> None:
        self._curves: dict[Key, Thinner] = defaultdict(lambda: Thinner(total))

    def add(self, key: Key, t: Array, values: Array) -> None:
        """Take the next samples (T,) [s] and (T,) of one curve."""
        self._curves[key].add(t, values)

    def points(self) -> dict[Key, Points]:
        """The points that are kept of each curve, in the order of their first samples."""
        return {key: curve.points() for key, curve in self._curves.items()}


def thin(t: Array, values: Array, points: int) -> Points:
    """At most `points` points of a curve (T,) [s] and (T,), see `Thinner`."""
    if t.size <= points:
        return Points(t, values)
    thinner = Thinner(t.size, points)
    thinner.add(t, values)
    return thinner.points()


def _extremes(values: Array, edges: NDArray[np.int64]) -> set[int]:
    """Indices of the smallest, the largest and the first non-finite value of each span."""
    kept = set()
    for begin, end in pairwise(edges.tolist()):
        part = values[begin:end]
        bad = np.flatnonzero(~np.isfinite(part))
        if bad.size:
            kept.add(begin + int(bad[0]))
        if bad.size < part.size:
            kept |= {begin + int(np.nanargmin(part)), begin + int(np.nanargmax(part))}
    return kept
