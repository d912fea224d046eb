"""Two sweeps, or two flights, side by side: differences paired by draw, each with its interval."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.sweep.plan import SweepPlan
from ptnsbc_sim.verdict.deadline import KEPT
from ptnsbc_tools.sweeps.summary import (
    DISTANCES,
    ERRORS,
    FlightTable,
    Share,
    new_table,
    number,
    share_of,
)

LEVEL = 0.05
_NORMAL = 1.959963984540054  # of the standard normal distribution, 97.5 %
_RESAMPLES = 2000

_DECIDING = "largest_after_all_m"


class ComparisonError(PtnsbcError):
    """Two things that cannot be compared."""


@dataclass(frozen=True)
class MetDifference:
    """The shares of flights that met the deadline, in A and in B, over the same draws."""

    a: Share
    b: Share
    only_a: int  # met in A and not in B
    only_b: int
    p: float  # McNemar, exact, two-sided
    low: float  # of the difference of the shares, B - A, 95 %
    high: float

    @property
    def worse(self) -> bool:
        """True if B meets less often, and that is no chance at 5 %."""
        return self.only_a > self.only_b and self.p < LEVEL


@dataclass(frozen=True)
class FigureDifference:
    """The median of B - A over the draws that have the figure in both."""

    name: str
    label: str
    pairs: int
    a: float  # median [m]
    b: float
    difference: float
    low: float  # of the difference, 95 %
    high: float


@dataclass(frozen=True)
class SweepComparison:
    """B beside A."""

    draws: int
    flights: MetDifference
    uavs: MetDifference
    in_place: MetDifference  # the UAVs that were at the deadline, whatever excuses the others
    figures: tuple[FigureDifference, ...]
    margin_m: float
    reasons: tuple[str, ...]  # why B is worse

    @property
    def worse(self) -> bool:
        """True if B is worse."""
        return bool(self.reasons)


def same_draws(a: SweepPlan, b: SweepPlan) -> None:
    """Raise an error unless draw k of both has the same start, seed and drawn values."""
    kept = ("seed", "axes", "starts", "family", "latin")
    names = [name for name in kept if getattr(a, name) != getattr(b, name)]
    if a.latin and b.latin and a.runs != b.runs:
        names.append("runs of a Latin hypercube")
    if names:
        raise ComparisonError(
            f"the sweeps draw differently ({', '.join(names)}): expected two sweeps that differ in the "
            "scenario or in its overrides only, so that the same draws are compared"
        )


def met_difference(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> MetDifference:
    """Met in A (n,) and in B (n,); the interval is that of Agresti and Min for pairs."""
    from scipy.stats import binomtest

    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    p = float(binomtest(only_b, only_a + only_b).pvalue) if only_a + only_b else 1.0  # McNemar
    more, n = only_b - only_a, len(a) + 2  # half a pair is added to each of the four counts
    spread = math.sqrt(only_a + only_b + 1 - more**2 / n) / n
    low, high = more / n - _NORMAL * spread, more / n + _NORMAL * spread
    shares = share_of(a), share_of(b)
    return MetDifference(*shares, only_a, only_b, p, max(low, -1.0), min(high, 1.0))


def _median(values: Array, axis: int = -1) -> Any:
    """The lower median: no mean of two values, of which one may be infinite."""
    middle = (values.shape[axis] - 1) // 2
    return np.take(np.sort(values, axis=axis), middle, axis=axis)


def median_difference(
    name: str, label: str, a: Array, b: Array, seed: int
) -> FigureDifference | None:
    """The median of B - A, its interval from a bootstrap over the draws; None without pairs."""
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
    low, high = np.sort(medians)[[int(0.025 * _RESAMPLES), int(0.975 * _RESAMPLES)]]
    found = (_median(a), _median(b), _median(change), low, high)
    return FigureDifference(name, label, len(change), *(float(value) for value in found))


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


def compare(a: FlightTable, b: FlightTable, *, margin_m: float, seed: int = 0) -> SweepComparison:
    """Compare the flights that both have; an error that grew by less than the margin is not worse."""
    a, b = in_both(a, b)
    flights = met_difference(a.flights.met, b.flights.met)
    uavs = met_difference(np.isin(a["verdict"], KEPT), np.isin(b["verdict"], KEPT))
    there = [of["in_place"].tolist() for of in (a, b)]  # None: not expected at the deadline
    expected = [pair for pair in zip(*there, strict=True) if None not in pair]
    in_place = met_difference(*np.array(expected, dtype=np.bool_).reshape(-1, 2).T)
    differences = (
        median_difference(name, label, a.of_flights(name), b.of_flights(name), seed)
        for label, name in (*ERRORS, *DISTANCES)
    )
    figures = tuple(difference for difference in differences if difference is not None)
    alone = len(a.flights.draw) == 1
    reasons = []
    if alone and uavs.only_a:
        reasons.append(f"{uavs.only_a} UAVs met the deadline in A and not in B")
    if not alone and flights.worse:
        reasons.append(f"B meets the deadline in fewer flights (p = {flights.p:.2g})")
    for one in figures:
        if not alone and one.name == _DECIDING and one.low > margin_m:
            reasons.append(f"{one.label} is larger by {one.difference:.4g} m in the median")
    draws, met = len(a.flights.draw), (flights, uavs, in_place)
    return SweepComparison(draws, *met, figures, margin_m, tuple(reasons))


def tables(found: SweepComparison) -> list[Table]:
    """The comparison as tables."""
    heads = ("", "A", "B", "only A", "only B", "B - A", "95 % interval", "p")
    met = new_table(f"Deadline met, draws in both: {found.draws}", heads)
    rows = {"flights": found.flights, "UAVs": found.uavs, "UAVs in place then": found.in_place}
    for name, one in rows.items():
        # UAVs of one flight are not independent: no interval
        p = f"{one.p:.3g}" if name == "flights" and found.draws > 1 else "-"
        more = f"{100 * (one.b.value - one.a.value):+.1f} %"
        interval = f"{100 * one.low:+.1f} to {100 * one.high:+.1f} %" if p != "-" else "-"
        counts = (f"{one.a.count} of {one.a.of}", f"{one.b.count} of {one.b.of}")
        met.add_row(name, *counts, str(one.only_a), str(one.only_b), more, interval, p)
    columns = ("each flight", "pairs", "A m", "B m", "B - A m", "95 % interval")
    medians = new_table("Medians, and the median difference", columns)
    for figure in found.figures:
        values = (f"{figure.a:.4g}", f"{figure.b:.4g}", f"{figure.difference:+.4g}")
        interval = f"{figure.low:+.4g} to {figure.high:+.4g}" if found.draws > 1 else "-"
        medians.add_row(figure.label, str(figure.pairs), *values, interval)
    return [met, medians]


def line(found: SweepComparison) -> Text:
    """The comparison in a sentence."""
    if found.worse:
        return Text.assemble(("B is worse", "bold red"), f": {'; '.join(found.reasons)}")
    if found.draws == 1:
        return Text(
            "B is not worse: no UAV that met in A fails in B; one flight each has no interval"
        )
    return Text("B is not worse at 5 %")


def as_json(found: SweepComparison) -> dict[str, Any]:
    """The comparison as plain data; UAVs of one flight are not independent: they have no test."""
    flights, uavs, in_place = (
        {**vars(of), "a": of.a.as_json(), "b": of.b.as_json()}
        for of in (found.flights, found.uavs, found.in_place)
    )
    figures = [
        {key: number(of) if isinstance(of, float) else of for key, of in vars(figure).items()}
        for figure in found.figures
    ]
    of_uavs, there = (
        {key: of[key] for key in ("a", "b", "only_a", "only_b")} for of in (uavs, in_place)
    )
    about = {"draws": found.draws, "worse": found.worse, "reasons": list(found.reasons)}
    both = {"flights": flights, "uavs": of_uavs, "in_place": there, "figures": figures}
    return {**about, "margin_m": found.margin_m, **both}
