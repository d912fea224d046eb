"""Figures as PNG, SVG or PDF by Matplotlib: the same flight gives the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario import Obstacle
from ptnsbc_sim.verdict.recording import Recording, tolerance_of
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
    thin,
)
from ptnsbc_tools.reading.bag_reader import StatusSeries

FORMATS = (".png", ".svg", ".pdf")
_SIZE_IN = (9.0, 4.2)
_DPI = 110
_CURVE_POINTS = 6000  # more than the page has pixels, and small enough for an SVG
_PATH_POINTS = 4000
_INSIDE = 12  # curves whose legend stands inside the axes; that of more below them
_ROW_IN = 0.17  # height of a row of that legend
_LONGEST_M = 20.0  # half of a cylinder without end
_UPRIGHT = 0.7  # vertical part of the normal below which a surface is drawn from above
_PAPER = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}


_IN_A_ROW = 8  # of a legend below the axes
# Without these a file contains the date and random names.
_UNDATED: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}


class FigureError(PtnsbcError):
    """A figure that cannot be drawn."""


def _style(of: Look) -> dict[str, Any]:
    return {"color": COLOURS[of.colour], "linestyle": DASHES[of.dash]}


def blank_figure(size_in: tuple[float, float]) -> Any:
    """A Matplotlib figure without axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout="constrained")
    FigureCanvasAgg(figure)  # pyplot would look for a screen
    return figure


def draw_chart(axes: Any, chart: Chart) -> None:
    """Draw a chart on Matplotlib axes."""
    if chart.log:
        axes.set_yscale("log")
    for number, (begin, end) in enumerate(chart.spans):
        label = "_" if number else chart.spans_label  # once in the legend
        axes.axvspan(begin, end, color=OBSTACLE, alpha=0.12, linewidth=0, label=label)
    if chart.band is not None:
        axes.axhspan(*chart.band, color=GOOD, alpha=0.10, linewidth=0, label=chart.band_label)
    for curve in chart.curves:
        points = thin(curve.t, curve.values, _CURVE_POINTS)
        axes.plot(points.t, points.values, label=curve.label, linewidth=1.2, **_style(curve.look))
    for limit in chart.limits:
        axes.axhline(limit.value, color="black", linewidth=0.9, linestyle=":")
        axes.annotate(limit.label, (1.0, limit.value), xycoords=("axes fraction", "data"),
                      xytext=(-4, 3), textcoords="offset points", ha="right", fontsize=8, bbox=_PAPER)  # fmt: skip
    for mark in chart.marks:
        axes.axvline(mark.t, color="black", linewidth=1)
        axes.annotate(mark.label, (mark.t, 1.0), xycoords=("data", "axes fraction"),
                      xytext=(4, -10), textcoords="offset points", fontsize=8)  # fmt: skip
    if not chart.log:
        axes.set_ylim(bottom=0)
    unit = f" [{chart.unit}]" if chart.unit else ""
    axes.set(xlabel="time after the epoch [s]", ylabel=f"{chart.quantity}{unit}")
    axes.set_title(chart.title, fontsize=10)
    axes.grid(alpha=0.3, which="both" if chart.log else "major")
    axes.margins(x=0.01)
    count = len(chart.curves)
    if 1 < count <= _INSIDE:
        entries = len(axes.get_legend_handles_labels()[0])
        axes.legend(fontsize=7, ncol=2 if entries > 6 else 1, loc="best")


def figure_of(chart: Chart, heading: str) -> Any:
    """A Matplotlib figure of one chart."""
    width, height = _SIZE_IN
    count = len(chart.curves)
    rows = -(-count // _IN_A_ROW) if count > _INSIDE else 0
    figure = blank_figure((width, height + _ROW_IN * rows))
    axes = figure.add_subplot()
    draw_chart(axes, chart)
    if rows:
        figure.legend(fontsize=7, ncols=_IN_A_ROW, loc="outside lower center")
    if chart.note:
        figure.supxlabel(chart.note, fontsize=7, x=0.01, ha="left")
    axes.set_title(f"{heading}: {chart.title}", fontsize=10)
    return figure


def format_of(path: Path) -> str:
    """The suffix of a figure, one of FORMATS; raise FigureError for any other."""
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise FigureError(
            f"{path}: suffix {kind or 'missing'}: expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
        )
    return kind


def save(figure: Any, path: Path) -> Path:
    """Write a figure; the suffix says whether as PNG, SVG or PDF."""
    import matplotlib

    kind = format_of(path)
    metadata = _UNDATED[kind]
    with replacing(path, folder=True) as part, matplotlib.rc_context({"svg.hashsalt": "ptnsbc"}):
        figure.savefig(part, dpi=_DPI, format=kind[1:], metadata=metadata)
    return path


def save_pages(figures: Sequence[Any], path: Path) -> Path:
    """Write figures as the pages of one PDF."""
    from matplotlib.backends.backend_pdf import PdfPages

    with replacing(path, folder=True) as part, PdfPages(part, metadata=_UNDATED[".pdf"]) as pages:
        for figure in figures:
            pages.savefig(figure)
    return path


def draw_paths(axes: Any, recording: Recording, paths: dict[int, Array] | None = None) -> None:
    """Draw the paths of all legs and the obstacles from above; `paths` where they are read already."""
    for index, (uav, path) in enumerate((paths or _paths(recording)).items()):
        style = _style(look(index))
        leader = " (leader)" if uav == recording.flown.leader.id else ""
        axes.plot(path[:, 0], path[:, 1], label=f"UAV {uav}{leader}", linewidth=1.3, **style)
        axes.plot(*path[0, :2], marker="o", color=style["color"], markersize=4)
        axes.plot(*path[-1, :2], marker="s", color=style["color"], markersize=5)
    for obstacle in recording.scenario.world.bodies:
        _obstacle_from_above(axes, obstacle)
    for obstacle in recording.scenario.world.bodies:
        if obstacle.path is not None:
            times = np.linspace(0.0, recording.scenario.timing.duration_s, _PATH_POINTS)
            way = obstacle.motion(times).positions
            axes.plot(way[:, 0], way[:, 1], color=OBSTACLE, linewidth=1.0, linestyle=":")
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]", aspect="equal")
    axes.set_title("From above; ○ start, □ end, grey: keep-out", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="upper right")


def _obstacle_from_above(axes: Any, obstacle: Obstacle) -> None:
    """A sphere's keep-out, the outline of another body, the line of an upright surface; nothing of a level one."""
    from matplotlib.patches import Circle, Polygon

    centre = tuple(obstacle.position[:2])
    look: dict[str, Any] = {"color": OBSTACLE, "alpha": 0.35}
    if obstacle.kind == "sphere":
        axes.add_patch(Circle(centre, obstacle.keep_out_m, **look))
    elif obstacle.kind == "cylinder":
        axes.add_patch(Circle(centre, obstacle.size[0], **look))
    elif obstacle.kind == "box":
        from scipy.spatial import ConvexHull

        corners = _corners(obstacle)[:, :2]
        axes.add_patch(Polygon(corners[ConvexHull(corners).vertices], **look))
    elif np.abs(obstacle.axes[2, 2]) < _UPRIGHT:
        along = np.array([-obstacle.axes[1, 2], obstacle.axes[0, 2]])
        axes.axline(centre, tuple(np.array(centre) + along), color=OBSTACLE, linewidth=2.0)
    else:
        return
    axes.annotate(obstacle.name, centre, ha="center", va="center", fontsize=8)


def _corners(obstacle: Obstacle) -> Array:
    """Corners (8, 3) [m] of a box."""
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    return np.asarray(obstacle.position + (signs * obstacle.size) @ obstacle.axes.T)


def _surface(obstacle: Obstacle) -> Array | None:
    """Points (3, U, V) [m] of the surface that is drawn in space; None for surfaces without end."""
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    if obstacle.kind == "sphere":
        ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)])
        return np.asarray(obstacle.position[:, None, None] + obstacle.keep_out_m * ball)
    if obstacle.kind == "cylinder":
        half = min(float(obstacle.size[1]), _LONGEST_M)
        tube = np.stack(
            [obstacle.size[0] * np.cos(turn), obstacle.size[0] * np.sin(turn), half * np.cos(rise)]
        )
        return np.asarray(obstacle.position[:, None, None] + tube)
    return None


def _in_space(axes: Any, recording: Recording, paths: dict[int, Array]) -> None:
    for index, path in enumerate(paths.values()):
        axes.plot(path[:, 0], path[:, 1], path[:, 2], linewidth=1.3, **_style(look(index)))
    for obstacle in recording.scenario.world.bodies:
        surface = _surface(obstacle)
        if surface is not None:
            axes.plot_surface(*surface, color=OBSTACLE, alpha=0.3, linewidth=0)
        elif obstacle.kind == "box":
            corners = _corners(obstacle)
            for a, b in combinations(range(8), 2):
                if (a ^ b).bit_count() == 1:  # an edge
                    axes.plot(*corners[[a, b]].T, color=OBSTACLE, linewidth=1.0)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    limits = axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()
    axes.set_box_aspect([np.ptp(pair) for pair in limits])
    axes.set_title("In space", fontsize=9)


def _paths(recording: Recording) -> dict[int, Array]:
    """Positions (T, 3) [m] of every UAV through all legs, thinned."""
    numbers = range(len(recording.forms))
    legs = [leg for k in numbers if (leg := replace(recording, leg=k)).samples > 1]
    every = max(sum(leg.samples for leg in legs) // _PATH_POINTS, 1)
    parts = [leg.at(block.stamps[::every]).positions for leg in legs for block in leg.blocks()]
    return {uav: np.concatenate([part[uav] for part in parts]) for uav in parts[0]}


def draw_flight(recording: Recording, path: Path, tolerance: float | None = None) -> Path:
    """Draw a recording that has a verdict into a PNG, SVG or PDF: from above, in space, and its formation error."""
    figure, paths = blank_figure((12, 9)), _paths(recording)
    panels = figure.add_gridspec(2, 2, height_ratios=(3, 2))
    draw_paths(figure.add_subplot(panels[0, 0]), recording, paths)
    _in_space(figure.add_subplot(panels[0, 1], projection="3d"), recording, paths)
    limit_m = tolerance_of(recording, tolerance)
    chart = errors(FlightView(recording, StatusSeries(), limit_m, None, ""))
    if chart is not None:
        draw_chart(figure.add_subplot(panels[1, :]), chart)
    scenario = recording.flown
    figure.suptitle(
        f"{scenario.name}: {scenario.plant.kind}, task {scenario.task_name}, "
        f"profile {scenario.gains.profile}, avoidance {scenario.formation.avoidance}"
    )
    return save(figure, path)
