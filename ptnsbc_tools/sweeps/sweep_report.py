"""The figures of a sweep, and its page: one HTML file that works offline."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from itertools import combinations
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario.fields import unit_of
from ptnsbc_tools.plotting.charts import COLOURS, GOOD, OBSTACLE
from ptnsbc_tools.plotting.draw import blank_figure, save
from ptnsbc_tools.report.page import asset, html_table
from ptnsbc_tools.sweeps import summary
from ptnsbc_tools.sweeps.summary import Column, FlownSweep, share_of

_MOST_BINS = 8
_LEAST_IN_BIN = 10
_MOST_MAPS = 3
_LOOKED_AT = 5
_FEW = 12  # so many different values are shown one by one
_HISTOGRAM_BINS = 40
_SIZE_IN = (6.4, 4.0)
START_ERROR = "largest start error [m]"


@dataclass(frozen=True)
class DrawnAxis:
    """The drawn values of each flight, in groups that are shown side by side."""

    name: str
    labels: tuple[str, ...]
    centres: Array  # (G,) where each group is shown
    group: NDArray[np.int64]  # (D,)

    @property
    def words(self) -> bool:
        """True if the groups are named, not placed."""
        return np.array_equal(self.centres, np.arange(len(self.labels)))


def grouped(name: str, values: Column) -> DrawnAxis | None:
    """The flights in groups of one value, or of one bin with as many flights as the others.

    None when all values are the same.
    """
    if values.dtype.kind == "f":
        values = np.where(np.isfinite(values), values, np.nan)
        if np.isnan(values).any():
            return None
    distinct, group = np.unique(values, return_inverse=True)
    if len(distinct) < 2:
        return None
    if values.dtype.kind not in "fiu":
        labels = tuple(str(one) for one in distinct)
        return DrawnAxis(name, labels, np.arange(len(distinct), dtype=np.float64), group)
    if len(distinct) <= min(_FEW, max(len(values) // 3, 2)):
        labels = tuple(f"{one:g}" for one in distinct)
        return DrawnAxis(name, labels, distinct.astype(np.float64), group)
    bins = min(max(len(values) // _LEAST_IN_BIN, 1), _MOST_BINS)
    order = np.argsort(values, kind="stable")
    group = np.empty(len(values), dtype=np.int64)
    group[order] = np.arange(len(values)) * bins // len(values)
    inside = [values[group == one] for one in range(bins)]
    labels = tuple(f"{part.min():.3g} to {part.max():.3g}" for part in inside)
    return DrawnAxis(name, labels, np.array([np.mean(part) for part in inside]), group)


def _label(key: str) -> str:
    unit = unit_of(key.rpartition(".")[2])
    return f"{key} [{unit}]" if unit else key


def drawn_axes(sweep: FlownSweep) -> list[DrawnAxis]:
    """Everything that differs between the flights: the axes of the plan first, the start error last."""
    drawn = sweep.table.drawn
    keys = [axis.key for axis in sweep.plan.axes]
    keys += [key for key in drawn if key not in keys]
    found = [grouped(_label(key), drawn[key]) for key in keys]
    found.append(grouped(START_ERROR, sweep.table.of_flights("start_error_m")))
    return [one for one in found if one is not None]


def draw_against(axes: Any, sweep: FlownSweep, axis: DrawnAxis) -> None:
    """Draw the share of flights met against something drawn on Matplotlib axes."""
    met = sweep.table.flights.met
    groups = range(len(axis.labels))
    shares = [share_of(met[axis.group == one]) for one in groups]
    bounds = np.array([[one.value - one.low, one.high - one.value] for one in shares])
    reach, values = np.maximum(bounds, 0.0).T, [one.value for one in shares]
    centres, colour = axis.centres, COLOURS[0]
    axes.errorbar(centres, values, yerr=reach, fmt="o", markersize=4, capsize=3, color=colour)
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.3)
    if axis.words:
        axes.set_xticks(axis.centres, axis.labels)
    axes.set(xlabel=axis.name, ylabel="share of flights met")
    axes.set_title(f"{sweep.plan.name}: bars are Wilson intervals at 95 %", fontsize=9)


def _heat_map(sweep: FlownSweep, first: DrawnAxis, second: DrawnAxis) -> Any:
    met = sweep.table.flights.met
    shape = (len(second.labels), len(first.labels))
    flown, kept = np.zeros(shape), np.zeros(shape)
    np.add.at(flown, (second.group, first.group), 1)
    np.add.at(kept, (second.group, first.group), met)
    with np.errstate(invalid="ignore"):
        shares = kept / flown
    figure = blank_figure((7.0, 5.0))
    axes = figure.add_subplot()
    image = axes.imshow(shares, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=1)
    for (row, column), count in np.ndenumerate(flown):
        if count:
            shown = f"{kept[row, column]:.0f}/{count:.0f}"
            colour = "black" if shares[row, column] > 0.6 else "white"
            axes.text(column, row, shown, ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(shape[1]), first.labels, rotation=30, ha="right", fontsize=7)
    axes.set_yticks(range(shape[0]), second.labels, fontsize=7)
    axes.set(xlabel=first.name, ylabel=second.name)
    axes.set_title(f"{sweep.plan.name}: flights met of flights flown", fontsize=9)
    figure.colorbar(image, label="share of flights met")
    return figure


def _pairs(sweep: FlownSweep) -> list[tuple[DrawnAxis, DrawnAxis]]:
    """The axes of the plan two by two."""
    keys = {_label(axis.key) for axis in sweep.plan.axes}
    varied = [axis for axis in drawn_axes(sweep) if axis.name in keys]
    return list(combinations(varied, 2))[:_MOST_MAPS]


def _distributions(sweep: FlownSweep) -> Any:
    table, flights = sweep.table, sweep.table.flights
    settled = table["settling_s"] / table["deadline_s"]
    panels: list[tuple[str, str, Array, float | None, str]] = [
        ("UAVs", "settling time / deadline", settled, 1.0, "deadline"),
        ("flights", "closest pair of UAVs [m]", table.of_flights("closest_uav_m"), None, ""),
    ]
    room = table.of_flights("closest_obstacle_m")
    if np.isfinite(room).any():
        panels.append(("flights", "room to the closest obstacle [m]", room, 0.0, "keep-out"))
    figure = blank_figure((11.0 if len(panels) > 2 else 8.0, 3.4))
    for axes, (what, label, values, limit, name) in zip(
        figure.subplots(1, len(panels)), panels, strict=True
    ):
        kept = values[np.isfinite(values)]
        if len(kept):
            axes.hist(kept, bins=_HISTOGRAM_BINS, color=COLOURS[0], alpha=0.8)
        if limit is not None:
            axes.axvline(limit, color=GOOD, linewidth=1.2)
            axes.annotate(name, (limit, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -9),
                          textcoords="offset points", fontsize=7)  # fmt: skip
        left_out = len(values) - len(kept)
        shown = f"{label}; not shown: {left_out} without one" if left_out else label
        axes.set_xlabel(shown, fontsize=8)
        axes.set_ylabel(what, fontsize=8)
        axes.grid(alpha=0.3, color=OBSTACLE)
    figure.suptitle(f"{sweep.plan.name}: {len(flights.draw)} flights", fontsize=9)
    return figure


def figures(sweep: FlownSweep) -> Iterator[tuple[str, str, Any]]:
    """All figures of a sweep that has flights: name of the file, caption, figure."""
    for number, axis in enumerate(drawn_axes(sweep), start=1):
        caption = f"Share of flights that met the deadline, against {axis.name}"
        figure = blank_figure(_SIZE_IN)
        draw_against(figure.add_subplot(), sweep, axis)
        yield f"success-{number}", caption, figure
    for number, (first, second) in enumerate(_pairs(sweep), start=1):
        caption = f"Flights met, against {first.name} and {second.name}"
        yield f"map-{number}", caption, _heat_map(sweep, first, second)
    caption = "When UAVs settled, and how close flights came"
    yield "distributions", caption, _distributions(sweep)


FOLDER = "report"


def _picture(caption: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    shown = escape(caption)
    return (
        f'<figure><img alt="{shown}" src="data:image/png;base64,{data}">'
        f"<figcaption>{shown}</figcaption></figure>"
    )


def write_report(sweep: FlownSweep) -> Path:
    """Write the page and the figures into `report/` of the sweep's folder; returns the page."""
    folder = sweep.folder / FOLDER
    pictures = [
        _picture(caption, save(figure, folder / f"{name}.png"))
        for name, caption, figure in figures(sweep)
    ]
    again = "\n".join(summary.look_first(sweep, _LOOKED_AT))
    more = (
        f"<p>The flights to look at, and the commands that fly them again:</p>\n<pre>{escape(again)}</pre>\n"
        + "\n".join(pictures)
        + f"\n<details><summary>Plan</summary><pre>{escape(sweep.plan.to_json())}</pre></details>"
    )
    words = {
        "name": sweep.plan.name,
        "heading": summary.title(sweep),
        "line": summary.line(sweep).plain,
    }
    page = Template(asset("sweep.html")).substitute(
        {key: escape(value) for key, value in words.items()},
        style=asset("style.css"),
        tables="\n".join(html_table(table) for table in summary.tables(sweep)),
        more=more,
    )
    with replacing(folder / "index.html", folder=True) as part:
        part.write_text(page, encoding="utf-8")
    return folder / "index.html"
