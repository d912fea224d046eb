"""Piecewise polynomials of time, several in one table.

A row of the table (S, 1 + 8 C) holds for one interval: its first time [s], then eight coefficients of each of the C
channels, the highest power first, of the time since the row began. The last row holds for ever.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.kernel import formula, inline_kernel
from ptnsbc_core.types import Array

COEFFICIENTS = 8
"""Of one polynomial: degree 7, which a curve of minimum snap has."""


class Jet(NamedTuple):
    """A function of time at one time, and its derivatives."""

    value: float
    first: float  # [1/s]
    second: float  # [1/s^2]
    third: float  # [1/s^3]


@inline_kernel
def row_at(table: Array, t: float) -> int:
    """The row that holds at t [s], by bisection; the first one before all of them."""
    low, high = 0, table.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@formula
def polynomial(table: Array, row: int, channel: int, t: float) -> Jet:
    """One channel of a row at t [s], by Horner's rule."""
    since = t - table[row, 0]
    first = 1 + COEFFICIENTS * channel
    value, slope, bend, twist = 0.0, 0.0, 0.0, 0.0
    for k in range(COEFFICIENTS):
        twist = twist * since + bend
        bend = bend * since + slope
        slope = slope * since + value
        value = value * since + table[row, first + k]
    return Jet(value, slope, 2.0 * bend, 6.0 * twist)
