"""Fewer points for the same curve: what stands out stays."""

from __future__ import annotations

from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

KEPT = 20_000
"""Points of a curve that are held in memory, more than any figure has."""

Key = TypeVar("Key")


class Points(NamedTuple):
    """Samples of one quantity."""

    t: Array  # (P,) [s]
    values: Array  # (P,)


class Thinner:
    """A curve that arrives block by block, at most `points` of it: the extremes of each of many spans.

    Every peak keeps its height and its time. A span with a value that is none keeps that one too, so
    that a gap stays a gap.

    Args:
        total: Samples that will come.
        points: At least 8.
    """

    def __init__(self, total: int, points: int = KEPT) -> None:
        self._short = total <= points
        self._edges = np.linspace(0, total, max((points - 2) // 3, 2) + 1).astype(np.int64)
        self._total = total
        self._taken = 0  # samples that belong to complete spans
        self._open = Points(np.empty(0), np.empty(0))  # of the span that is not complete
        self._parts: list[Points] = []

    def add(self, t: Array, values: Array) -> None:
        """Take samples (T,) [s] and (T,), ascending."""
        if self._short:
            self._parts.append(Points(t, values))
            return
        held = Points(np.append(self._open.t, t), np.append(self._open.values, values))
        seen = self._taken + held.t.size
        first, last = np.searchsorted(self._edges, (self._taken, seen), side="right") - 1
        done = int(self._edges[last]) - self._taken
        if done:
            kept = _extremes(held.values, self._edges[first : last + 1] - self._taken)
            # The ends of the curve stay too.
            kept |= {0} if self._taken == 0 else set()
            kept |= {done - 1} if seen == self._total else set()
            chosen = np.array(sorted(kept), dtype=np.int64)
            self._parts.append(Points(held.t[chosen], held.values[chosen]))
        self._open = Points(held.t[done:], held.values[done:])
        self._taken += done

    def points(self) -> Points:
        """What is kept."""
        t, values = zip(*self._parts, strict=True)
        return Points(np.concatenate(t), np.concatenate(values))


class ThinnedCurves(Generic[Key]):
    """Thinned curves by key.

    Args:
        total: Samples that will come of each.
    """

    def __init__(self, total: int) -> None:
        self._total = total
        self._curves: dict[Key, Thinner] = {}

    def add(self, key: Key, t: Array, values: Array) -> None:
        """Take samples (T,) [s] and (T,) of one curve."""
        if key not in self._curves:
            self._curves[key] = Thinner(self._total)
        self._curves[key].add(t, values)

    def points(self) -> dict[Key, Points]:
        """What is kept of each, in the order in which they came."""
        return {key: curve.points() for key, curve in self._curves.items()}


def thin(t: Array, values: Array, points: int) -> Points:
    """At most `points` points of a curve (T,) [s] and (T,), see `Thinner`."""
    if t.size <= points:
        return Points(t, values)
    thinner = Thinner(t.size, points)
    thinner.add(t, values)
    return thinner.points()


def _extremes(values: Array, edges: NDArray[np.int64]) -> set[int]:
    """Numbers of the smallest and the largest value of each span, and of the first that is none."""
    kept = set()
    for begin, end in pairwise(edges.tolist()):
        part = values[begin:end]
        bad = np.flatnonzero(~np.isfinite(part))
        if bad.size:
            kept.add(begin + int(bad[0]))
        if bad.size < part.size:
            kept |= {begin + int(np.nanargmin(part)), begin + int(np.nanargmax(part))}
    return kept
