"""Figures as PNG, SVG or PDF by Matplotlib: the same flight gives the same bytes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario import Obstacle
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.verdict.recording import Recording
from ptnsbc_tools.plotting.charts import (
    COLOURS,
    DASHES,
    GOOD,
    OBSTACLE,
    Chart,
    FlightView,
    Look,
    errors,
    look,
)
from ptnsbc_tools.tables import who_came

FORMATS = (".png", ".svg", ".pdf")
FROM_ABOVE = (0, 1)
_AXES = ("x (east) [m]", "y (north) [m]", "z (up) [m]")
COLUMNS_IN: Mapping[str, float] = {"one": 3.5, "two": 7.16}
"""Widths of the columns of a journal [in]."""
_SIZE_IN = (9.0, 4.2)
_HEIGHT = 0.6  # of a figure for a column, of its width
_COLUMN_FONT = 8.0
_DPI, _COLUMN_DPI = 110, 300
_PATH_POINTS = 4000
_UPRIGHT = 0.7  # part of the normal along the line of sight from which on a surface is not drawn
_TITLE = 110  # letters in a line
_SNAPSHOTS = 5  # of the formation
_PAPER = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
_BELOW = 3.2  # from the axes to the legend below them, of the size of the font
# Widths of a letter of a legend and of what stands before a name, of its size
_LETTER, _HANDLE = 0.6, 3.5
_ENTRY_IN, _ROW_IN = 1.0, 0.15  # of a legend
_LETTER_HIGH = 1.2  # and of a line, of the font
_SMALL = 0.8  # letters of a legend, of the size of the font
_LEFT_OVER = 0.75  # of the height of axes, beside a legend
_BEHIND_CURVES = 1.5  # zorder

# Without these a file contains the date and random names.
_UNDATED: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
# Journals take no fonts of type 3.
_FILES = {"svg.hashsalt": "ptnsbc", "pdf.fonttype": 42, "ps.fonttype": 42}


def _style(of: Look) -> dict[str, Any]:
    return {"color": COLOURS[of.colour], "linestyle": DASHES[of.dash]}


def blank_figure(size_in: tuple[float, float]) -> Any:
    """A Matplotlib figure without axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout="constrained", dpi=_DPI)
    FigureCanvasAgg(figure)  # pyplot would look for a screen
    return figure


def sized(columns: str | None) -> AbstractContextManager[None]:
    """Inside the `with` figures have the fonts of one or two columns of a journal; None: of a screen."""
    from matplotlib import rc_context

    if columns not in (None, *COLUMNS_IN):
        raise PtnsbcError(f"columns {columns}: {similar(columns, COLUMNS_IN)}")
    return rc_context({} if columns is None else {"font.size": _COLUMN_FONT})


def draw_chart(axes: Any, chart: Chart, *, legend: bool = True, labels: bool = True) -> None:
    """Draw a chart on Matplotlib axes, in the sizes of `rcParams`.

    `legend`: name the curves, below the axes; `labels`: name limits and times at their lines.
    """
    from matplotlib import rcParams
    from matplotlib.ticker import NullLocator

    if chart.floor:
        axes.set_yscale("log")
        axes.yaxis.set_minor_locator(NullLocator())
    for curve in chart.curves:
        axes.plot(curve.t, curve.values, label=curve.label, linewidth=1.2, **_style(curve.look))
    for number, (begin, end) in enumerate(chart.spans):
        label = "_" if number else chart.spans_label  # once in the legend
        axes.axvspan(begin, end, color=OBSTACLE, alpha=0.12, linewidth=0, label=label)
    if chart.band is not None:
        axes.axhspan(*chart.band, color=GOOD, alpha=0.10, linewidth=0, label=chart.band_label)
    words: dict[str, Any] = {"textcoords": "offset points", "fontsize": "small", "bbox": _PAPER,
                             "zorder": _BEHIND_CURVES}  # fmt: skip
    for limit in chart.limits:
        axes.axhline(limit.value, color="black", linewidth=0.9, linestyle=":")
        if labels:
            axes.annotate(limit.label, (1.0, limit.value), xycoords=("axes fraction", "data"),
                          xytext=(-3, 3), ha="right", **words)  # fmt: skip
    for mark in chart.marks:
        axes.axvline(mark.t, color="black", linewidth=0.8)
    axes.margins(x=0.01, y=0.12)  # words stand above the highest limit
    axes.set_ylim(bottom=chart.floor)
    unit = f" [{chart.unit}]" if chart.unit else ""
    points = 72.0 * axes.get_window_extent().height / axes.get_figure(root=True).dpi
    letters = int(_LEFT_OVER * points / (_LETTER * rcParams["font.size"]))
    axes.set(xlabel="time after the epoch [s]")
    axes.set_ylabel(textwrap.fill(f"{chart.quantity}{unit}", max(letters, 1)))
    axes.set_title(chart.title, fontsize="medium")
    axes.grid(alpha=0.3)
    begin, end = axes.get_xlim()
    wide = (end - begin) * _LETTER_HIGH * rcParams["font.size"] * axes.figure.dpi / 72.0
    wide /= axes.get_window_extent().width  # of a word, in time
    following = [mark.t for mark in chart.marks[1:]] + [math.inf]
    for mark, next_s in zip(chart.marks, following, strict=False) if labels else ():
        left = next_s - mark.t < wide  # the next word is to the right of it
        side = {"xytext": (-2, -3), "ha": "right"} if left else {"xytext": (2, -3), "ha": "left"}
        axes.annotate(mark.label, (mark.t, 1.0), xycoords=("data", "axes fraction"),
                      rotation=90, va="top", **side, **words)  # fmt: skip
    if legend and len(chart.curves) > 1:
        _legend_below(axes)


def _legend_below(axes: Any) -> None:
    """Name the curves below the axes, where they cover none; a figure without a layout gets one that has room there."""
    from matplotlib import rcParams
    from matplotlib.transforms import ScaledTranslation

    figure, size = axes.get_figure(root=True), rcParams["font.size"]
    if figure.get_layout_engine() is None:
        figure.set_layout_engine("constrained")
    names = axes.get_legend_handles_labels()[1]
    entry = (_LETTER * np.mean([len(name) for name in names]) + _HANDLE) * _SMALL * size
    width = 72.0 * axes.get_window_extent().width / figure.dpi
    down = ScaledTranslation(0.0, -_BELOW * size / 72.0, figure.dpi_scale_trans)
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=axes.transAxes + down,
        ncols=min(max(int(width / entry), 1), len(names)),
        fontsize=_SMALL * size,
        frameon=False,
        handlelength=1.5,
        columnspacing=1.2,
    )


def figure_of(chart: Chart, heading: str, columns: str | None = None) -> Any:
    """A Matplotlib figure of one chart; one for columns of a journal has no title, its caption says that."""
    size = _SIZE_IN
    if columns is not None:
        size = COLUMNS_IN[columns], _HEIGHT * COLUMNS_IN[columns]
    rows = len(chart.curves) * _ENTRY_IN // size[0]  # of the legend, beyond the first
    figure = blank_figure((size[0], size[1] + _ROW_IN * rows))
    figure.dpi = _DPI if columns is None else _COLUMN_DPI
    axes = figure.add_subplot()
    draw_chart(axes, chart)
    title, note = (f"{heading}: {chart.title}", chart.note) if columns is None else ("", "")
    axes.set_title(title, fontsize="medium")
    if note:
        figure.supxlabel(note, fontsize="x-small", x=0.01, ha="left")
    return figure


def format_of(path: Path) -> str:
    """The suffix of a figure, one of FORMATS; raise PtnsbcError for any other."""
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise PtnsbcError(
            f"{path}: suffix {kind or 'missing'}: expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        )
    return kind


def save(figure: Any, path: Path) -> Path:
    """Write a figure; the suffix says whether as PNG, SVG or PDF."""
    import matplotlib

    kind = format_of(path)
    with replacing(path, folder=True) as part, matplotlib.rc_context(_FILES):
        figure.savefig(part, dpi=figure.dpi, format=kind[1:], metadata=_UNDATED[kind])
    return path


def save_pages(figures: Sequence[Any], path: Path) -> list[Path]:
    """Write figures as the pages of one PDF; no file for none."""
    if not figures:
        return []
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    with (
        replacing(path, folder=True) as part,
        rc_context(_FILES),
        PdfPages(part, metadata=_UNDATED[".pdf"]) as pages,
    ):
        for figure in figures:
            pages.savefig(figure)
    return [path]


def draw_paths(
    axes: Any, recording: Recording, *, view: tuple[int, int] = FROM_ABOVE, legend: bool = True
) -> None:
    """Draw the paths of all legs, the formation at some times, and the obstacles where they were then.

    `view`: the axes of the world, to the right and up.
    """
    from matplotlib.lines import Line2D

    paths, times, scenario = _paths(recording), _snapshots(recording), recording.flown
    colours = {uav: COLOURS[look(index).colour] for index, uav in enumerate(paths)}
    for index, (uav, path) in enumerate(paths.items()):
        leader = " (leader)" if uav == scenario.leader.id else ""
        label = f"UAV {uav}{leader}"
        axes.plot(*path[:, view].T, label=label, linewidth=1.0, **_style(look(index)))
    stamps = recording.start_ns + np.array([nanoseconds(t) for t in times])
    positions = np.moveaxis(recording.at(stamps).positions, 0, 2)
    places = dict(zip(scenario.uav_ids, positions, strict=True))
    later_s = seconds(recording.start_ns - recording.first_ns)
    names = [
        (f"{t:.3g} s", place[None, view])
        for t, place in zip(times, places[scenario.leader.id], strict=True)
    ]
    for uav, place in places.items():
        parent = scenario.communication.parent(uav)
        for own, other in zip(place, places[parent], strict=True) if parent is not None else ():
            axes.plot(*np.stack([own, other])[:, view].T, color="black", linewidth=1.2, alpha=0.6)
        axes.plot(*place[:, view].T, "o", color=colours[uav], markersize=5)
    written = {obstacle.name for obstacle in scenario.world.obstacles}
    for obstacle in scenario.world.bodies:
        moves = obstacle.path is not None
        centres = obstacle.motion(np.array(times if moves else times[:1]) + later_s).positions
        for k, centre in enumerate(centres, 1):
            _outline(axes, obstacle, centre, view, 0.4 * k / len(centres))
        if obstacle.name in written:  # pieces of a cloud have names that nobody gave
            names.append((obstacle.name, centres[:, view]))
        if moves:
            way = obstacle.motion(np.linspace(0.0, times[-1] + later_s, _PATH_POINTS)).positions
            # No plot: what flies is fitted into the axes, and not the way of an obstacle.
            axes.add_artist(Line2D(*way[:, view].T, color=OBSTACLE, linewidth=1.0, linestyle=":"))
    axes.set(xlabel=_AXES[view[0]], ylabel=_AXES[view[1]])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("From above" if view == FROM_ABOVE else "From the south", fontsize="medium")
    axes.grid(alpha=0.3)
    if legend:
        _legend_below(axes)
    _name(axes, names)


def _snapshots(recording: Recording) -> list[float]:
    """Times [s] at which the formation is shown: the start, the deadline, and some until the end of the leg."""
    deadline_s = recording.flown.gains.formation.deadline_s
    end_s = float(seconds(recording.end_ns - recording.start_ns))
    if end_s <= deadline_s:
        return [0.0, end_s]
    return [0.0, *np.linspace(deadline_s, end_s, _SNAPSHOTS - 1).tolist()]


def _name(axes: Any, names: Sequence[tuple[str, Array]]) -> None:
    """Write each name beside the last of its points (K, 2) that is seen, where it covers no other name and no UAV."""
    from matplotlib.transforms import Bbox

    axes.get_figure(root=True).draw_without_rendering()  # where the layout has put the axes
    lines = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
    dots = axes.transData.transform(np.concatenate(lines))
    taken = [Bbox.from_extents(*(dot - 3.0), *(dot + 3.0)) for dot in dots]
    around = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    for name, points in names:
        seen = [at for at in points if axes.bbox.contains(*axes.transData.transform(at))]
        if not seen:
            continue
        text = axes.annotate(name, seen[-1], (0, 0), textcoords="offset points", ha="center",
                             va="center", fontsize="x-small", zorder=5, bbox=_PAPER)  # fmt: skip
        for far, angle in product((9.0, 16.0, 24.0, 34.0), around):
            text.set_position((far * np.sin(angle), far * np.cos(angle)))
            box = text.get_window_extent()
            inside = box.y1 <= axes.bbox.y1  # above is the title
            if inside and not any(Bbox.intersection(box, other) for other in taken):
                break
        taken.append(box)


def _outline(
    axes: Any, obstacle: Obstacle, centre: Array, view: Sequence[int], alpha: float
) -> None:
    """The outline of an obstacle, of a sphere that of its keep-out; nothing of a surface seen from its front."""
    from matplotlib.patches import Circle, Polygon
    from scipy.spatial import ConvexHull

    style: dict[str, Any] = {"color": OBSTACLE, "alpha": alpha, "linewidth": 1.0}
    [across] = {0, 1, 2} - set(view)
    body = obstacle.drawn()
    if obstacle.kind == "sphere" or (obstacle.kind == "cylinder" and across == 2):
        axes.add_artist(Circle((centre[view[0]], centre[view[1]]), 0.5 * body.size[0], **style))
    elif obstacle.kind in ("box", "cylinder") or abs(obstacle.axes[across, 2]) < _UPRIGHT:
        signs = np.array(list(product((-0.5, 0.5), repeat=3)))
        middle = body.centre - obstacle.position + centre
        corners = (middle + (signs * body.size) @ obstacle.axes.T)[:, view]
        axes.add_artist(Polygon(corners[ConvexHull(corners).vertices], **style))


def _paths(recording: Recording) -> dict[int, Array]:
    """Positions (T, 3) [m] of every UAV through all legs, thinned."""
    numbers = range(len(recording.forms))
    legs = [leg for k in numbers if (leg := replace(recording, leg=k)).samples > 1]
    every = max(sum(leg.samples for leg in legs) // _PATH_POINTS, 1)
    parts = [leg.at(block.stamps[::every]).positions for leg in legs for block in leg.blocks()]
    places = np.concatenate(parts, axis=2).T  # (T, N, 3)
    return {uav: places[:, row] for row, uav in enumerate(recording.scenario.uav_ids)}


def draw_flight(flight: FlightView, path: Path) -> Path:
    """Draw a flight into a PNG, SVG or PDF: its verdict, its paths from two sides, and its formation error."""
    figure, scenario = blank_figure((12, 10)), flight.scenario
    panels = figure.add_gridspec(2, 2, height_ratios=(5, 4), width_ratios=(3, 2))
    views = {view: figure.add_subplot(panels[0, k]) for k, view in enumerate((FROM_ABOVE, (0, 2)))}
    chart = errors(flight)
    if chart is not None:
        draw_chart(figure.add_subplot(panels[1, :]), chart)
    if flight.verdict is not None:
        line = f"{flight.verdict.verdict}. {who_came(flight.verdict.legs[0])}"
        figure.suptitle(textwrap.fill(f"{scenario.name}: {line}", _TITLE))
    for view, axes in views.items():  # last: names need the layout
        draw_paths(axes, flight.recording, view=view, legend=False)
    return save(figure, path)
