"""The style of every figure: the width of a journal's column, its fonts, and colours that readers can tell apart."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ptnsbc_tools.plotting.charts import COLOURS as PALETTE

COLUMN_MM = 88.0
_MM_PER_INCH = 25.4
_DPI = 220

# Those of all other figures, each with a dash of its own; yellow is too pale for a line of a journal
COLOURS = PALETTE[:7]
DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)), (0, (3, 1, 1, 1, 1, 1)),
    (0, (8, 2)), "-",
)  # fmt: skip
GREY = "#7F7F7F"

_SETTINGS = {
    "font.family": "DejaVu Sans",  # comes with Matplotlib: the same glyphs everywhere
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.2,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.4,
    "lines.linewidth": 1.0,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "ptnsbc",  # ids in an SVG are random otherwise
    "path.simplify": True,
}


def line(index: int) -> dict[str, Any]:
    """Colour and dash of curve number `index`."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": DASHES[index % len(DASHES)]}


def stacked_mm(rows: int) -> float:
    """Height of a figure with so many rows of panels."""
    return 32.0 * rows + 20.0


def figure(height_mm: float) -> Any:
    """An empty figure of a journal's column width."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(COLUMN_MM / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    FigureCanvasAgg(drawing)  # no pyplot: it would look for a screen
    return drawing


@contextmanager
def applied() -> Iterator[None]:
    """Matplotlib with our settings inside the block."""
    import matplotlib

    with matplotlib.rc_context(_SETTINGS):
        yield


def legend(drawing: Any, axes: Any, columns: int) -> None:
    """The legend of one panel above all of them, where it covers no curve."""
    handles, labels = axes.get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside upper center", ncols=columns)


def log_scale(axes: Any) -> None:
    """A logarithmic vertical axis with numbers at 1, 2 and 5 of each decade, written out."""
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.minorticks_off()


def round_ticks(axis: Any, count: int) -> None:
    """At most `count` intervals on an axis, at 1, 2 and 5 of a decade."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]))


def save(drawing: Any, folder: Path, name: str) -> None:
    """Write a figure as PNG and SVG, the same bytes every time."""
    folder.mkdir(parents=True, exist_ok=True)
    drawing.savefig(folder / f"{name}.png", dpi=_DPI, metadata={"Software": "ptnsbc"})
    drawing.savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": "ptnsbc"})
