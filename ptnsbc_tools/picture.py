"""The flight in one picture: from above, in space, and the formation error against its deadline."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.charts import style
from ptnsbc_tools.limits import SHARE_OF_START
from ptnsbc_tools.verdict.deadline import formation_errors
from ptnsbc_tools.verdict.recording import Recording, complete

_FLOOR_M = 1e-4


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


def _error(axes: Any, recording: Recording, times: Array, errors: dict[int, Array]) -> None:
    tolerance = recording.scenario.file.formation.tolerance_m
    band = max(tolerance, *(SHARE_OF_START * error[0] for error in errors.values()))
    for index, (uav, error) in enumerate(errors.items()):
        axes.semilogy(times, np.maximum(error, _FLOOR_M), label=f"UAV {uav}", **_look(index))
    deadline = recording.scenario.gains.formation.deadline_s
    axes.axvline(deadline, color="black", linewidth=1)
    axes.annotate(f"deadline {deadline:g} s", (deadline, axes.get_ylim()[1]), fontsize=8,
                  xytext=(4, -10), textcoords="offset points")  # fmt: skip
    axes.axhspan(_FLOOR_M, band, color=style.GOOD, alpha=0.08, label=f"widest band {band:.2f} m")
    axes.axhline(tolerance, color="black", linewidth=0.8, linestyle=":",
                 label=f"limit at the deadline {tolerance:g} m")  # fmt: skip
    axes.set(xlabel="time after the epoch [s]", ylabel="formation error [m]")
    axes.set_title("Formation error; leader: distance from its trajectory", fontsize=9)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7, ncol=2, loc="upper right")


def draw(recording: Recording, path: Path) -> Path:
    """Draw a recording into a PNG and return its path."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    grid = complete(recording).grid()
    positions = recording.positions(grid)
    figure = Figure(figsize=(12, 9), layout="constrained")
    FigureCanvasAgg(figure)  # no pyplot: it would look for a screen
    panels = figure.add_gridspec(2, 2, height_ratios=(3, 2))
    _from_above(figure.add_subplot(panels[0, 0]), recording, positions)
    _in_space(figure.add_subplot(panels[0, 1], projection="3d"), recording, positions)
    errors = formation_errors(recording, grid, positions)
    _error(figure.add_subplot(panels[1, :]), recording, recording.times(grid), errors)
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
