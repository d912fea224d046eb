"""The envelope: success against one quantity at a time, from where it is easy to where it fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import yaml

from paper.experiment_result import ExperimentResult, Figure, Table
from paper.figures import style
from paper.output import ExperimentFolder
from paper.swept import DEFAULT_APPROACH, SweepCase, fly_case, met, shares_table
from ptnsbc_tools.sweeps.summary import FlightTable, Share
from ptnsbc_tools.sweeps.sweep_report import plot_shares

RUNS = 40
_DEADLINE_S, _AFTER_S = 6.0, 4.0
_EASY: dict[str, Any] = {
    "name": "envelope",
    "size": 5,
    "tree": {"kinds": ["random"], "depth": 3},
    "shape": {"kinds": ["v", "grid", "circle"], "spacing_m": [1.5, 3]},
    "starts": {"kind": "near", "sigma_m": [0.1, 0.5]},
    "path": {"kinds": ["hover", "line", "circle"], "speed_m_s": [0.2, 1], "radius_m": [3, 8]},
    "deadline": {"seconds": _DEADLINE_S, "after_s": _AFTER_S},
}
_TURN_M = 4.0
_FIXES = {"rate_hz": 10, "acceleration_noise_m_s2": 0.05, "latency_s": 0.05}
_FEW = {"kind": "box", "box_m": [10, 10, 4]}


class Drawn(NamedTuple):
    """Blocks of the family, and keys of the scenario, that differ from the easy case."""

    family: Mapping[str, Any] = {}
    keys: Mapping[str, Any] = {}


class EnvelopeAxis(NamedTuple):
    """One quantity, its values, and what each makes of the easy case."""

    name: str
    unit: str
    values: tuple[float, ...]
    drawn: Callable[[float], Drawn]

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


def _path(kind: str, speed: float) -> Drawn:
    return Drawn({"path": {"kinds": [kind], "speed_m_s": speed, "radius_m": _TURN_M}})


AXES = (
    EnvelopeAxis(
        "start distance, standard deviation per axis", "m", (0.1, 0.3, 1.0, 2.0, 3.0, 4.0, 6.0),
        lambda x: Drawn({"starts": {"kind": "near", "sigma_m": x}}),
    ),
    EnvelopeAxis(
        "deadline", "s", (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0),
        lambda x: Drawn({"deadline": {"seconds": x, "after_s": _AFTER_S}}),
    ),
    EnvelopeAxis("UAVs", "", (2, 5, 10, 20, 30), lambda x: Drawn({"size": int(x)})),
    EnvelopeAxis(
        "depth of a chain", "hops", (1, 2, 4, 7, 10, 15),
        lambda x: Drawn({"size": int(x) + 1, "tree": {"kinds": ["chain"]}}),
    ),
    EnvelopeAxis(
        "leader speed on a line", "m/s", (0.5, 1.0, 2.0, 3.0, 4.0, 5.0), lambda x: _path("line", x)
    ),
    EnvelopeAxis(
        f"leader acceleration on a circle of {_TURN_M:g} m", "m/s²", (0.1, 0.5, 1.0, 2.0, 3.0, 4.0),
        lambda x: _path("circle", float(np.sqrt(x * _TURN_M))),
    ),
    EnvelopeAxis(
        "delay of messages", "s", (0.0, 0.05, 0.1, 0.2, 0.3, 0.4), lambda x: Drawn({"delay_s": x})
    ),
    EnvelopeAxis(
        "loss of messages", "", (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8),
        lambda x: Drawn(keys={"communication.loss": x}),
    ),
    EnvelopeAxis(
        "noise of position fixes, per axis", "m", (0.0, 0.01, 0.02, 0.05, 0.1, 0.2),
        lambda x: Drawn(keys={"sensor.positioning": {**_FIXES, "noise_m": x}} if x else {}),
    ),
    EnvelopeAxis(
        "wind, with gusts of a quarter of it", "m/s", (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0),
        lambda x: Drawn({"wind": {"mean_m_s": x, "gust_m_s": 0.25 * x}}),
    ),
    EnvelopeAxis(
        "true mass over the mass that the laws know", "", (0.6, 0.7, 0.8, 1.0, 1.2, 1.3, 1.4),
        lambda x: Drawn({"mass": {"mass_scale": x}}),
    ),
    EnvelopeAxis(
        "obstacles among starts in a box of 10 m", "", (0, 2, 4, 8, 12),
        lambda x: Drawn({
            "starts": _FEW, "deadline": {"seconds": 8.0, "after_s": _AFTER_S},
            "obstacles": {"count": int(x), "keep_out_m": [0.5, 1.0], "where": "anywhere"},
        } if x else {"starts": _FEW, "deadline": {"seconds": 8.0, "after_s": _AFTER_S}}),
    ),
)  # fmt: skip


def case(axis: EnvelopeAxis, value: float) -> SweepCase:
    """The sweep of one value."""
    drawn = axis.drawn(value)
    family = yaml.safe_dump({**_EASY, **drawn.family}, sort_keys=False)
    keys = {**DEFAULT_APPROACH, **drawn.keys}
    return SweepCase((f"{value:g}",), changes=keys, starts="file", family=family,
                     stop_after_s=None, runs=RUNS)  # fmt: skip


Swept = dict[str, dict[float, FlightTable]]
"""Flights by axis and value."""


def _figure(output: ExperimentFolder, swept: Swept) -> Figure:
    rows = (len(swept) + 1) // 2
    drawing = style.figure(38.0 * rows)
    grid = drawing.subplots(rows, 2, squeeze=False, sharey=True)
    curves = {}
    for number, (axes, (name, tables)) in enumerate(zip(grid.flat, swept.items(), strict=False)):
        shares = [met(table) for table in tables.values()]
        plot_shares(axes, np.array(list(tables)), shares)
        axes.set_title(fill(name, 30), fontsize=6.5)
        curves[f"axis{number + 1}_value"] = np.array(list(tables))
        for part in ("value", "low", "high"):
            column = np.array([getattr(one, part) for one in shares])
            curves[f"axis{number + 1}_{part.replace('value', 'share')}"] = column
    for axes in grid.flat[len(swept) :]:
        axes.set_visible(False)
    drawing.supylabel("share of flights met", fontsize=8)
    caption = "Share of flights met against one quantity at a time; bars: Wilson intervals at 95 %"
    figure = Figure("envelope", "How far it goes", caption, telling=True)
    return output.write_figure(figure, drawing, curves)


def reach(tables: Mapping[float, Share]) -> str:
    """In words: where at least nine of ten flights are met, and the first value where fewer than half are."""
    good = [value for value, one in tables.items() if one.value >= 0.9]
    lost = [value for value, one in tables.items() if one.value < 0.5]
    most = f"nine of ten flights are met at {', '.join(f'{v:g}' for v in good)}" if good else (
        "at no value nine of ten flights are met"
    )  # fmt: skip
    return f"{most}; fewer than half at {', '.join(f'{v:g}' for v in lost) or 'none'}."


def _tables(swept: Swept) -> Iterator[Table]:
    for name, tables in swept.items():
        rows = (((f"{value:g}",), table) for value, table in tables.items())
        found = reach({value: met(table) for value, table in tables.items()})
        yield shares_table(name, name.capitalize(), (name,), rows, found.capitalize())


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep every axis."""
    swept = {
        axis.title: {
            value: fly_case(output, axis.name, case(axis, value)).table for value in axis.values
        }
        for axis in AXES
    }
    return ExperimentResult(
        "envelope",
        "One quantity at a time",
        f"{RUNS} flights for each row, at least 200 for each table. The easy case: five UAVs in a random tree of "
        "depth 3 at most and a shape of V, grid or circle, 1.5 to 3 m apart, starts 0.1 to 0.5 m per axis beside the "
        "places, a leader that hovers, or flies a line or a circle at up to 1 m/s, deadline "
        f"{_DEADLINE_S:g} s, and nothing in the way. The vehicle is the quadrotor of `paper_5_free`, the law the "
        "default: planned approach, profile `soft`. One quantity leaves the easy case at a time. *Flights met* counts "
        "a flight in which a UAV entered a keep-out as not met.",
        figures=(_figure(output, swept),),
        tables=tuple(_tables(swept)),
        page="envelope",
    )
