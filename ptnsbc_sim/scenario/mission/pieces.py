"""Tables of polynomials (`ptnsbc_core.curves.trajectory`): through knots, at other knots, summed, and as a curve.

A row is the time at which its polynomials begin, and the coefficients of each channel, the highest power first, of the
time since then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from ptnsbc_core.curves.trajectory import COEFFICIENTS
from ptnsbc_core.types import HEADING_TABLE, TRAJECTORY_PIECEWISE, Array, Trajectory

CHANNELS = 4  # of a curve: x, y, z, yaw
WIDTH = 1 + COEFFICIENTS * CHANNELS
NO_TABLE = np.zeros((0, WIDTH))
YAW = 12  # column of `curve_samples`

_BINOMIALS = np.array(
    [
        [math.comb(k, j) for j in reversed(range(COEFFICIENTS))]
        for k in reversed(range(COEFFICIENTS))
    ]
)


def curve_by(kind: int, *numbers: float, table: Array = NO_TABLE) -> Trajectory:
    """A curve as `ptnsbc_core.curves.trajectory` reads it."""
    return Trajectory(tuple(float(number) for number in (kind, *numbers)), table)


def curve_of(
    rows: Array, heading: int = HEADING_TABLE, period_s: float = 0.0, yaw: float = 0.0
) -> Trajectory:
    """The curve of a table (K, 33), whose last row stays at its end."""
    rows = np.ascontiguousarray(rows)
    return curve_by(TRAJECTORY_PIECEWISE, heading, period_s, 0, 0, 0, 0, yaw, table=rows)


def at_knots(table: Array, times: Array) -> Array:
    """The same polynomials with a row at each of the times (K,), among which all of its own are."""
    rows = np.maximum(np.searchsorted(table[:, 0], times, side="right") - 1, 0)
    since = (times - table[rows, 0])[:, None, None]
    held = table[rows, 1:].reshape(len(times), -1, COEFFICIENTS)
    power = np.arange(COEFFICIENTS)[::-1]  # of each coefficient
    rise = power[:, None] - power[None, :]  # from a new power to that of a given one
    shift = np.where(rise >= 0, _BINOMIALS * since ** np.maximum(rise, 0), 0.0)
    moved = (held[:, :, :, None] * shift[:, None]).sum(axis=2)
    return np.column_stack([times, moved.reshape(len(times), -1)])


def summed(table: Array, other: Array, sign: float = 1.0) -> Array:
    """A table with `sign` times the first three channels of another one added to its own, at the knots of both."""
    times, width = np.union1d(table[:, 0], other[:, 0]), 1 + 3 * COEFFICIENTS
    total = at_knots(table, times)
    total[:, 1:width] += sign * at_knots(other[:, :width], times)[:, 1:]
    return total


def hermite(times: Array, values: Sequence[Array]) -> Array:
    """Polynomials (K - 1, 8) between K knots, the highest power first, of the time since each of them.

    Args:
        times: (K,) [s].
        values: of each knot the value and its derivatives, as many as are known, at most four.
    """
    known, spans = np.array([len(value) for value in values]), np.diff(times)
    out = np.zeros((len(spans), COEFFICIENTS))
    for before, after in set(pairwise(known.tolist())):
        at = np.flatnonzero((known[:-1] == before) & (known[1:] == after))
        rows: list[int] = at.tolist()
        size, span = before + after, spans[rows, None]
        first = np.stack([values[row] for row in rows]) * span ** np.arange(before)
        last = np.stack([values[row + 1] for row in rows]) * span ** np.arange(after)
        of_share = np.linalg.solve(conditions(before, after), np.hstack([first, last]).T).T
        out[rows, COEFFICIENTS - size :] = (of_share / span ** np.arange(size))[:, ::-1]
    return out


@cache
def conditions(before: int, after: int) -> Array:
    """Derivatives of the powers of s, the lowest first: so many at s = 0, and so many at s = 1."""
    size = before + after
    powers = [np.poly1d([1.0, *[0.0] * power]) for power in range(size)]
    ends = [(0.0, k) for k in range(before)] + [(1.0, k) for k in range(after)]
    return np.array([[power.deriv(k)(s) if k else power(s) for power in powers] for s, k in ends])
