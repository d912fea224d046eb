"""Largest values that the command line and the library take: times beyond them have no nanosecond."""

from __future__ import annotations

from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError

LONGEST_S = 1e6  # as timing.duration_s
FASTEST_HZ = 1e4
MOST_RUNS = 1_000_000
LARGEST_SEED = 10**18
DRY_RUNS = 20  # perturbed flights before a flight
SHORTEST_WINDOW_S = 0.01
FINEST_M, FARTHEST_M = 1e-6, 1e6


class LimitError(PtnsbcError):
    """A value outside the range in which it has a meaning."""


def path_of(name: str, value: Any) -> Path:
    """The path in an argument; LimitError when it is none."""
    if not isinstance(value, str | PathLike):
        raise LimitError(f"{name}: {value!r:.40}: expected a path")
    return Path(value)


def refuse_outside(name: str, value: Any, low: float = 0.0, high: float = LONGEST_S) -> None:
    """Raise LimitError for a value that is not in `low` to `high`, such as NaN; None is no value.

    Between whole limits a value is whole.
    """
    kind: Any = Integral if isinstance(low, int) else Real
    whole = "a whole number, " if kind is Integral else ""
    if value is None or (isinstance(value, kind) and low <= value <= high):
        return
    plain = isinstance(value, int | float) and -1e300 < value < 1e300
    given = f"{value:g}" if plain else repr(value)[:40]
    raise LimitError(f"{name}: {given}: expected {whole}{low:g} to {high:g}")
