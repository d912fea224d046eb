"""Panels over time, and the line of each UAV in every figure."""

from __future__ import annotations

from typing import Any

from paper.figures import style
from paper.flights import JudgedFlight
from ptnsbc_core.types import Array
from ptnsbc_sim.verdict.encounters import ancestors

SPLIT_S = 6.0
DEADLINE_NOTE = "upright line: the deadline"
_THIN, _THICK = 0.6, 1.2

Row = tuple[Any, Any]
"""The two panels of a row: the approach, and the rest of the flight."""


def is_large(flight: JudgedFlight) -> bool:
    """True if there are too many UAVs to have a colour each."""
    return len(flight.uavs) > len(style.COLOURS)


def uav_label(flight: JudgedFlight, uav: int) -> str:
    """Name of a UAV in a legend."""
    return f"UAV {uav} (leader)" if uav == flight.scenario.leader.id else f"UAV {uav}"


def uav_line(flight: JudgedFlight, uav: int) -> dict[str, Any]:
    """Colour, dash and label of a UAV; in a large formation those of its chain."""
    if not is_large(flight):
        return {"label": uav_label(flight, uav), **style.line(flight.uavs.index(uav))}
    chain = _chain(flight, uav)
    if chain == 0:
        return {"color": "black", "linewidth": _THICK, "label": uav_label(flight, uav)}
    heads = [one for one in flight.scenario.followers if _chain(flight, one) == one]
    line = {**style.line(heads.index(chain)), "linewidth": _THIN}
    return {**line, "label": f"chain of UAV {chain}"} if uav == chain else line


def _chain(flight: JudgedFlight, uav: int) -> int:
    """The leader's child that a UAV follows directly or through others; 0 for the leader."""
    above = ancestors(flight.scenario, uav)  # from the UAV itself up to the leader
    return above[-2] if len(above) > 1 else 0


def split_rows(
    drawing: Any, titles: tuple[str, ...], end_s: float, *, one_scale: bool = True
) -> list[Row]:
    """A row for each title, on one vertical scale or on a scale for each row."""
    grid = drawing.add_gridspec(len(titles), 2)
    rows: list[Row] = []
    for row, title in enumerate(titles):
        left = drawing.add_subplot(grid[row, 0], sharey=rows[0][0] if rows and one_scale else None)
        right = drawing.add_subplot(grid[row, 1], sharey=left)
        right.tick_params(labelleft=False)
        left.set_xlim(0, SPLIT_S)
        right.set_xlim(SPLIT_S, end_s)
        left.set_title(title, loc="left")
        style.round_ticks(left.xaxis, 6)
        style.round_ticks(left.yaxis, 5)
        if row < len(titles) - 1:
            left.tick_params(labelbottom=False)
            right.tick_params(labelbottom=False)
        rows.append((left, right))
    drawing.supxlabel("time after the epoch [s]", fontsize=8)
    return rows


def profile_titles(profiles: Any) -> tuple[str, ...]:
    """Like `(a) profile paper`, for each profile."""
    return tuple(
        f"({letter}) profile {name}" for letter, name in zip("abc", profiles, strict=False)
    )


def plot_both(row: Row, times: Array, values: Array, **line: Any) -> None:
    """A curve in both panels of a row."""
    for axes in row:
        axes.plot(times, values, **line)


def deadline_line(axes: Any, flight: JudgedFlight) -> None:
    """A line at the deadline."""
    axes.axvline(flight.deadline_s, color="black", linewidth=0.6)


def weight_line(axes: Any, flight: JudgedFlight) -> None:
    """A line at the weight."""
    axes.axhline(flight.weight_n, color="black", linewidth=0.6, linestyle=":")
