"""A figure over time as plain data, for Matplotlib and for the report page, with the look of its curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

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
