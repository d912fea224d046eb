"""Fewer points for the same curve: what stands out stays."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array


class Points(NamedTuple):
    """Samples of one quantity."""

    t: Array  # (P,) [s]
    values: Array  # (P,)


def thin(t: Array, values: Array, points: int) -> Points:
    """At most `points` points: the smallest and the largest value of each of many spans.

    Every peak keeps its height and its time. A span with a value that is none keeps that one too, so
    that a gap stays a gap.

    Args:
        t: (T,) ascending.
        values: (T,).
        points: At least 8.
    """
    if t.size <= points:
        return Points(t, values)
    edges = np.linspace(0, t.size, max((points - 2) // 3, 2) + 1).astype(np.int64)
    kept = {0, t.size - 1}
    for begin, end in pairwise(edges):
        part = values[begin:end]
        bad = np.flatnonzero(~np.isfinite(part))
        if bad.size:
            kept.add(int(begin + bad[0]))
        if bad.size < part.size:
            kept |= {int(begin + np.nanargmin(part)), int(begin + np.nanargmax(part))}
    chosen = np.array(sorted(kept), dtype=np.int64)
    return Points(t[chosen], values[chosen])
