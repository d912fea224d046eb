"""Sweeps, or flights, beside a first one: differences paired by draw, each with its interval."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.sweep.plan import SweepPlan
from ptnsbc_sim.verdict.deadline import KEPT
from ptnsbc_sim.verdict.verdict import plain
from ptnsbc_tools.sweeps.summary import DISTANCES, ERRORS, FlightTable, share_of
from ptnsbc_tools.tables import Summary

LEVEL = 0.05
_RESAMPLES = 2000
_HEADS = ("", "pairs", "A", "B", "B - A", "low", "high", "p", "of B")

_DECIDING = "largest_after_all_m"


class ComparisonError(PtnsbcError):
    """Two things that cannot be compared."""


@dataclass(frozen=True)
class PairedFigure:
    """A figure in A and in B, over the pairs that have it in both: a share, or the median of flights."""

    name: str
    label: str
    pairs: int
    a: float
    b: float
    difference: float  # B - A; of medians the median difference
    low: float = math.nan  # of the difference; NaN of UAVs and of one flight
    high: float = math.nan
    p: float = math.nan  # of a share, McNemar, exact, two-sided; of several comparisons by Holm
    only_a: int = 0  # pairs that met in A and not in B
    only_b: int = 0


@dataclass(frozen=True)
class Compared:
    """One sweep or flight, B, beside A."""

    name: str
    draws: int
    differences: tuple[PairedFigure, ...]
    margin_m: float

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons why it is worse; empty when it is not."""
        found = {one.name: one for one in self.differences}
        flights, lost, largest = found["flights"], found["uavs"].only_a, found.get(_DECIDING)
        if self.draws == 1:
            return (f"{lost} UAVs met the deadline in A and not in {self.name}",) if lost else ()
        reasons = []
        if flights.only_a > flights.only_b and flights.p < LEVEL:
            reasons.append(f"{self.name} meets the deadline in fewer flights (p = {flights.p:.2g})")
        if largest is not None and largest.low > self.margin_m:
            what = largest.label.removesuffix(" [m]")
            reasons.append(f"{what} is larger by {largest.difference:.4g} m in the median")
        return tuple(reasons)

    def __str__(self) -> str:
        if self.reasons:
            return f"{self.name} is worse: {'; '.join(self.reasons)}"
        alone = self.draws == 1
        return f"{self.name} is not worse{', of one flight each' if alone else ' at 5 %'}"


@dataclass(frozen=True, repr=False)
class SweepComparison:
    """Sweeps or flights beside A; `print` shows their differences."""

    others: tuple[Compared, ...]

    @property
    def worse(self) -> bool:
        """True if one of them is worse."""
        return any(one.reasons for one in self.others)

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons why others are worse; empty when none is."""
        return tuple(reason for one in self.others for reason in one.reasons)

    @property
    def summary(self) -> Summary:
        """The shares that were met and the medians of errors and distances, and their differences."""
        values = operator.attrgetter("label", "pairs", "a", "b", "difference", "low", "high", "p")
        rows = (
            dict(zip(_HEADS, (*values(one), beside.name), strict=True))
            for beside in self.others
            for one in beside.differences
        )
        return Summary(f"Shares met, and medians; {self.others[0].draws} draws in both", (*rows,))

    def __str__(self) -> str:
        return f"{self.summary}\n{self!r}"

    def __repr__(self) -> str:
        return "\n".join(map(str, self.others))


def same_draws(a: SweepPlan, b: SweepPlan) -> None:
    """Raise an error unless draw k of both has the same start, seed and drawn values."""
    kept = ("seed", "axes", "starts", "family", "points")
    names = [name for name in kept if getattr(a, name) != getattr(b, name)]
    if names:
        raise ComparisonError(
            f"the sweeps draw differently ({', '.join(names)}): expected two sweeps that differ in the "
            "scenario or in its overrides only, so that the same draws are compared"
        )


def met_difference(
    name: str, label: str, a: NDArray[np.bool_], b: NDArray[np.bool_], level: float = math.nan
) -> PairedFigure:
    """Met in A (n,) and in B (n,); the interval is that of Agresti and Min for pairs, NaN without a level."""
    from scipy.stats import binomtest, norm

    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    p = float(binomtest(only_b, only_a + only_b).pvalue) if only_a + only_b else 1.0  # McNemar
    more, n = only_b - only_a, len(a) + 2  # half a pair is added to each of the four counts
    reach = norm.isf(0.5 * level) * math.sqrt(only_a + only_b + 1 - more**2 / n) / n
    met_a, met_b = share_of(a).value, share_of(b).value
    low, high = np.clip([more / n - reach, more / n + reach], -1.0, 1.0)
    shares = np.array([met_a, met_b, met_b - met_a, low, high])
    first, second, change, low, high = (100.0 * shares).tolist()
    p = p if level > 0.0 else math.nan
    return PairedFigure(name, label, len(a), first, second, change, low, high, p, only_a, only_b)


def _median(values: Array, axis: int = -1) -> Any:
    """The lower median: no mean of two values, of which one may be infinite."""
    middle = (values.shape[axis] - 1) // 2
    return np.take(np.sort(values, axis=axis), middle, axis=axis)


def median_difference(
    name: str, label: str, a: Array, b: Array, seed: int, level: float = LEVEL
) -> PairedFigure | None:
    """The median of B - A, its interval from a bootstrap over the draws, NaN of one; None without pairs."""
    both = ~(np.isnan(a) | np.isnan(b))
    if not both.any():
        return None
    a, b = a[both], b[both]
    with np.errstate(invalid="ignore"):
        change = np.where(a == b, 0.0, b - a)  # infinite in both: no difference
    rng = np.random.default_rng(seed)
    medians = [
        _median(change[rng.integers(len(change), size=len(change))]) for _ in range(_RESAMPLES)
    ]
    ends = 0.5 * level, 1.0 - 0.5 * level
    low, high = np.sort(medians)[[int(end * _RESAMPLES) for end in ends]].tolist()
    of_a, of_b, middle = (float(_median(values)) for values in (a, b, change))
    interval = (low, high) if len(change) > 1 else (math.nan, math.nan)
    return PairedFigure(name, label, len(change), of_a, of_b, middle, *interval)


def in_both(a: FlightTable, b: FlightTable) -> tuple[FlightTable, FlightTable]:
    """The rows of the draws and UAVs that both have, in the same order."""
    rows = [
        {key: k for k, key in enumerate(zip(*map(np.ndarray.tolist, columns), strict=True))}
        for columns in ((one["draw"], one["uav"]) for one in (a, b))
    ]
    draws = set(a["draw"].tolist()) & set(b["draw"].tolist())
    pairs = sorted(key for key in rows[0].keys() & rows[1].keys() if key[0] in draws)
    if not pairs:
        raise ComparisonError("no draw was flown in both: expected the same draws")
    if any(key[0] in draws for key in rows[0].keys() ^ rows[1].keys()):
        raise ComparisonError("a draw has other UAVs in A than in B: expected the same fleet")
    names = [field for field in a.columns if field in b.columns]
    first, second = (
        FlightTable({name: table[name][[of[pair] for pair in pairs]] for name in names})
        for table, of in zip((a, b), rows, strict=True)
    )
    return first, second


def compare(
    a: FlightTable, others: Mapping[str, FlightTable], *, margin_m: float, seed: int = 0
) -> SweepComparison:
    """Compare each of the others with A; an error that grew by less than the margin is not worse.

    With several of them the intervals hold together (Bonferroni), and the p values are those of Holm.
    """
    found = [
        _beside(name, *in_both(a, b), margin_m, seed, LEVEL / len(others))
        for name, b in others.items()
    ]
    corrected = holm([one.differences[0].p for one in found])
    return SweepComparison(
        tuple(
            replace(one, differences=(replace(one.differences[0], p=p), *one.differences[1:]))
            for one, p in zip(found, corrected, strict=True)
        )
    )


def _beside(
    name: str, a: FlightTable, b: FlightTable, margin_m: float, seed: int, level: float
) -> Compared:
    draws = len(a.flights.draw)
    there = [of["in_place"].tolist() for of in (a, b)]  # None: not expected at the deadline
    expected = [pair for pair in zip(*there, strict=True) if None not in pair]
    in_place = np.array(expected, dtype=np.bool_).reshape(-1, 2).T
    kept_a, kept_b = (np.isin(of["verdict"], KEPT) for of in (a, b))
    # UAVs of one flight are not independent, and one flight has no interval.
    several = level if draws > 1 else math.nan
    found = [
        met_difference("flights", "flights met [%]", a.flights.met, b.flights.met, several),
        met_difference("uavs", "UAVs met [%]", kept_a, kept_b),
        met_difference("in_place", "UAVs in place [%]", in_place[0], in_place[1]),
        *(
            median_difference(
                key, f"{label} [m]", a.of_flights(key), b.of_flights(key), seed, level
            )
            for label, key in (*ERRORS, *DISTANCES)
        ),
    ]
    return Compared(name, draws, tuple(one for one in found if one is not None), margin_m)


def holm(p: Sequence[float]) -> list[float]:
    """The p values (n,) of n comparisons, corrected by Holm's method."""
    order = np.argsort(p)
    steps = np.sort(p) * np.arange(len(p), 0, -1)
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected.tolist()


def as_json(found: Compared) -> dict[str, Any]:
    """A comparison as plain data."""
    return plain({**asdict(found), "worse": bool(found.reasons), "reasons": found.reasons})
