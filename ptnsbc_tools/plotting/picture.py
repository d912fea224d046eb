"""The flight in one picture: from above, in space, and the formation error against its deadline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.plotting import style
from ptnsbc_tools.plotting.draw import fill
from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.plotting.space import errors
from ptnsbc_tools.plotting.status import StatusSeries
from ptnsbc_tools.verdict.recording import Recording, tolerance_of

_POINTS = 4000  # of a path


def _look(index: int) -> dict[str, Any]:
    chosen = style.look(index)
    colour, dash = style.COLOURS[chosen.colour], style.DASHES[chosen.dash]
    return {"color": colour, "linestyle": dash, "linewidth": 1.3}


def _from_above(axes: Any, recording: Recording, positions: dict[int, Array]) -> None:
    from matplotlib.patches import Circle

    for index, (uav, path) in enumerate(positions.items()):
        look = _look(index)
        leader = " (leader)" if uav == recording.scenario.leader_id else ""
        axes.plot(path[:, 0], path[:, 1], label=f"UAV {uav}{leader}", **look)
        axes.plot(*path[0, :2], marker="o", color=look["color"], markersize=4)
        axes.plot(*path[-1, :2], marker="s", color=look["color"], markersize=5)
    for obstacle in recording.scenario.obstacles:
        centre = tuple(obstacle.position[:2])
        axes.add_patch(Circle(centre, obstacle.keep_out_m, color=style.OBSTACLE, alpha=0.35))
        axes.annotate(obstacle.name, centre, ha="center", va="center", fontsize=8)
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]", aspect="equal")
    axes.set_title("From above; ○ start, □ end, grey: keep-out", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="upper right")


def _in_space(axes: Any, recording: Recording, positions: dict[int, Array]) -> None:
    for index, path in enumerate(positions.values()):
        axes.plot(path[:, 0], path[:, 1], path[:, 2], **_look(index))
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)])
    for obstacle in recording.scenario.obstacles:
        x, y, z = obstacle.position[:, None, None] + obstacle.keep_out_m * ball
        axes.plot_surface(x, y, z, color=style.OBSTACLE, alpha=0.3, linewidth=0)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect([np.ptp(limits) for limits in _limits(axes)])
    axes.set_title("In space", fontsize=9)


def _limits(axes: Any) -> tuple[Any, Any, Any]:
    return axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()


def _paths(legs: Sequence[Recording]) -> dict[int, Array]:
    """Positions (T, 3) [m] of every UAV through all legs, thinned."""
    every = max(sum(leg.samples for leg in legs) // _POINTS, 1)
    parts = [leg.positions(grid[::every]) for leg in legs for grid in leg.grids()]
    return {uav: np.concatenate([part[uav] for part in parts]) for uav in parts[0]}


def draw(recording: Recording, path: Path, tolerance: float | None = None) -> Path:
    """Draw all legs of a recording that has a verdict into a PNG and return its path.

    Args:
        recording: the flight.
        path: PNG to write.
        tolerance: [m], the scenario's by default.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    forms = range(len(recording.forms))
    legs = [leg for number in forms if (leg := replace(recording, leg=number)).samples > 1]
    positions = _paths(legs)
    figure = Figure(figsize=(12, 9), layout="constrained")
    FigureCanvasAgg(figure)  # no pyplot: it would look for a screen
    panels = figure.add_gridspec(2, 2, height_ratios=(3, 2))
    _from_above(figure.add_subplot(panels[0, 0]), recording, positions)
    _in_space(figure.add_subplot(panels[0, 1], projection="3d"), recording, positions)
    chart = errors(Shown(recording, StatusSeries(), tolerance_of(recording, tolerance), None, ""))
    if chart is not None:
        fill(figure.add_subplot(panels[1, :]), chart)
    scenario = recording.scenario
    figure.suptitle(
        f"{scenario.name}: {scenario.plant_kind}, task {scenario.file.formation.task}, "
        f"profile {scenario.gains.profile}, avoidance {scenario.file.formation.avoidance}"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    # Beside and renamed: a picture that is there is whole.
    beside = path.with_name(f".{path.name}.part")
    figure.savefig(beside, dpi=style.DPI, format="png")
    return beside.replace(path)
