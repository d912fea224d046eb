"""A figure over time as plain data, for Matplotlib and for the report page, and curves with fewer points."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

# The palette of Okabe and Ito, for all common kinds of colour blindness. On a dark page black and the darkest
# blue would be invisible.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
DARK_COLOURS = (
    "#4DA6E0", "#E69F00", "#2BBF95", "#F07B2E", "#DD93BB", "#8CD0F5", "#E8E8E8", "#F0E442"
)  # fmt: skip
DASHES = ("-", "--", "-.", ":")
_OTHER_DASH = 3  # of another flight: dots
OBSTACLE = "#7F7F7F"
GOOD = "#009E73"

_IN_MEMORY = 20_000  # points of a curve; no figure shows more
Key = TypeVar("Key", bound=Hashable)


class Look(NamedTuple):
    """The style of one curve."""

    colour: int  # index into COLOURS
    dash: int  # index into DASHES


def look(index: int) -> Look:
    """Colour and dash of UAV number `index`; dashes distinguish UAVs of the same colour."""
    return Look(index % len(COLOURS), (index // len(COLOURS)) % len(DASHES))


@dataclass(frozen=True)
class Curve:
    """One quantity over time."""

    label: str
    look: Look
    t: Array  # (T,) [s] after the epoch
    values: Array  # (T,)
    uavs: tuple[int, ...]  # UAVs that it shows; hidden with any of them
    other: bool = False  # of another flight, drawn beside this one


@dataclass(frozen=True)
class Limit:
    """A horizontal line: an upper or lower limit."""

    value: float
    label: str


@dataclass(frozen=True)
class Mark:
    """A vertical line."""

    t: float  # [s] after the epoch
    label: str


@dataclass(frozen=True)
class Span:
    """A shaded span of time."""

    begin: float  # [s] after the epoch
    end: float


@dataclass(frozen=True)
class Chart:
    """The content of one set of axes."""

    key: str  # name on the command line and of its file
    title: str
    unit: str
    curves: tuple[Curve, ...]
    log: bool = False
    limits: tuple[Limit, ...] = ()
    marks: tuple[Mark, ...] = ()
    band: tuple[float, float] | None = None  # good values
    band_label: str = ""
    spans: tuple[Span, ...] = ()  # times in which the error of some UAV is excused
    spans_label: str = ""
    note: str = ""

    @property
    def quantity(self) -> str:
        """The label of the vertical axis."""
        name = self.title.split(":")[-1].split(",")[0].strip()
        return name[:1].lower() + name[1:]


def overlaid(charts: Sequence[Chart], others: Sequence[Chart], name: str) -> list[Chart]:
    """The charts with the curves of another flight in the charts of the same key: in the same colours, dotted."""
    by_key = {chart.key: chart for chart in others}

    def with_others(chart: Chart) -> Chart:
        other = by_key.get(chart.key)
        if other is None:
            return chart
        curves = [
            replace(
                one,
                label=f"{one.label}, {name}",
                look=Look(one.look.colour, (one.look.dash + _OTHER_DASH) % len(DASHES)),
                other=True,
            )
            for one in other.curves
        ]
        note = f"{chart.note} Dotted, in the same colours: {name}.".strip()
        return replace(chart, curves=(*chart.curves, *curves), note=note)

    return [with_others(chart) for chart in charts]


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
