"""Figures as PNG or SVG, the same bytes for the same flight."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools.plotting import style
from ptnsbc_tools.plotting.chart import Chart
from ptnsbc_tools.plotting.thin import thin

FORMATS = (".png", ".svg")
_POINTS = 6000  # more than the page has pixels, and small enough for an SVG
_MOST_IN_LEGEND = 12
_PAPER = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}


class FigureError(PtnsbcError):
    """A figure that cannot be drawn or written."""


def fill(axes: Any, chart: Chart) -> None:
    """Draw a chart into axes of its own."""
    if chart.log:
        axes.set_yscale("log")
    for span in chart.spans:
        axes.axvspan(span.begin, span.end, color=style.OBSTACLE, alpha=0.12, linewidth=0)
    if chart.band is not None:
        axes.axhspan(*chart.band, color=style.GOOD, alpha=0.10, linewidth=0)
    for curve in chart.curves:
        look = {
            "color": style.COLOURS[curve.look.colour],
            "linestyle": style.DASHES[curve.look.dash],
        }
        points = thin(curve.t, curve.values, _POINTS)
        axes.plot(points.t, points.values, label=curve.label, linewidth=1.2, **look)
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
    if 1 < len(chart.curves) <= _MOST_IN_LEGEND:
        axes.legend(fontsize=7, ncol=2 if len(chart.curves) > 6 else 1, loc="best")


def figure_of(chart: Chart, heading: str) -> Any:
    """A Matplotlib figure of one chart."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(style.WIDTH_IN, style.HEIGHT_IN), layout="constrained")
    FigureCanvasAgg(figure)  # no pyplot: it would look for a screen
    axes = figure.add_subplot()
    fill(axes, chart)
    axes.set_title(f"{heading}: {chart.title}", fontsize=10)
    return figure


def save(figure: Any, path: Path) -> Path:
    """Write a figure; the suffix says whether PNG or SVG."""
    import matplotlib

    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise FigureError(f"{path}: suffix {kind or 'missing'}: expected {' or '.join(FORMATS)}")
    beside = path.with_name(f".{path.name}.part")
    # Without these an SVG carries the date and names of chance.
    metadata = {"Date": None} if kind == ".svg" else {"Software": None}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with matplotlib.rc_context({"svg.hashsalt": "ptnsbc"}):
            figure.savefig(beside, dpi=style.DPI, format=kind[1:], metadata=metadata)
        return beside.replace(path)
    except OSError as error:
        raise FigureError(f"{path}: cannot be written: {error.strerror}") from error
