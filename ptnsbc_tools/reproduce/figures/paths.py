"""Trajectories in space and from above: Figs. 5-8, 24, 25 and 33."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.flights import JudgedFlight

_TELLING = (5, 6)  # those that the short page shows
FORMATION_S = (5.0, 20.0, 35.0, 50.0)  # when the lines from above join each UAV to its parent
_MARKS = "dots: starts, squares: the end"


def columns(flown: JudgedFlight) -> dict[str, Array]:
    """Time and positions of all UAVs."""
    found = {"time_s": times_column(flown.times)}
    for row, uav in enumerate(flown.scenario.uav_ids):
        for axis, letter in enumerate("xyz"):
            found[f"uav{uav}_{letter}_m"] = flown.positions[:, row, axis]
    return found


def uav_label(flown: JudgedFlight, uav: int) -> str:
    """Name of a UAV in a legend."""
    return f"UAV {uav} (leader)" if uav == flown.scenario.leader_id else f"UAV {uav}"


def spheres(axes: Any, flown: JudgedFlight) -> None:
    """The obstacles' keep-outs in 3-D."""
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)])
    for obstacle in flown.scenario.obstacles:
        x, y, z = obstacle.position[:, None, None] + obstacle.keep_out_m * ball
        axes.plot_surface(x, y, z, color=style.GREY, alpha=0.3, linewidth=0)


def in_space(workshop: ExperimentFolder, flown: JudgedFlight, number: int, suffix: str) -> Figure:
    """Trajectories in 3-D."""
    made = style.figure(80)
    axes = space(made)
    places = flown.positions
    for row, uav in enumerate(flown.scenario.uav_ids):
        path, look = places[:, row], style.look(row)
        axes.plot(*path.T, label=uav_label(flown, uav), **look)
        axes.scatter(*path[0], color=look["color"], s=8, marker="o", depthshade=False)
        axes.scatter(*path[-1], color=look["color"], s=10, marker="s", depthshade=False)
    spheres(axes, flown)
    tidy_3d(axes)
    made.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=3)
    note = _MARKS + (", grey: keep-out spheres" if flown.scenario.obstacles else "")
    return _kept(workshop, flown, made, (number, "3d"), f"Trajectories in space{suffix}; {note}")


def _kept(
    workshop: ExperimentFolder, flown: JudgedFlight, made: Any, which: tuple[int, str], caption: str
) -> Figure:
    """Write a figure, `which` is its number in the paper and the end of its name."""
    number, end = which
    name = f"fig_{number:02d}_{flown.scenario.name}_{end}"
    workshop.figure(name, made, columns(flown))
    return Figure(name, f"Fig. {number}", caption, telling=number in _TELLING)


def shape_note() -> str:
    """What dots, squares and grey lines of a figure from above mean, for its caption."""
    instants = ", ".join(f"{seconds:g}" for seconds in FORMATION_S)
    return f"{_MARKS}, grey lines: who follows whom at {instants} s"


def space(made: Any) -> Any:
    """Axes in 3-D that fill the figure below its legend; the automatic layout knows no 3-D labels."""
    made.set_layout_engine("none")
    return made.add_axes((-0.04, 0.09, 0.94, 0.78), projection="3d")


def tidy_3d(axes: Any, zoom: float = 0.96) -> None:
    """Labels, true proportions, few ticks."""
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]", zlabel="z (up) [m]")
    limits = (axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d())
    axes.set_box_aspect([np.ptp(one) for one in limits], zoom=zoom)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        style.round_ticks(axis, 5)
        axis.labelpad = 0
        axis.set_tick_params(pad=-1)


def from_above(workshop: ExperimentFolder, flown: JudgedFlight, number: int, suffix: str) -> Figure:
    """Trajectories in the X-Y plane."""
    made = style.figure(96)
    axes = made.add_subplot()
    draw_from_above(axes, flown)
    style.legend(made, axes, columns=3)
    note = shape_note()
    if flown.scenario.obstacles:
        note += ", grey discs: keep-out spheres, which paths across them pass above or below"
    return _kept(workshop, flown, made, (number, "xy"), f"Trajectories from above{suffix}; {note}")


def draw_from_above(axes: Any, flown: JudgedFlight) -> None:
    """Paths, obstacles, starts, ends and the formation at a few instants."""
    discs(axes, flown)
    for seconds in FORMATION_S:
        links(axes, flown, int(np.argmin(np.abs(flown.times - seconds))))
    for row, uav in enumerate(flown.scenario.uav_ids):
        path, look = flown.positions[:, row], style.look(row)
        axes.plot(path[:, 0], path[:, 1], label=uav_label(flown, uav), **look)
        axes.plot(*path[0, :2], marker="o", color=look["color"], markersize=3)
        axes.plot(*path[-1, :2], marker="s", color=look["color"], markersize=3)
    level(axes)


def discs(axes: Any, flown: JudgedFlight) -> None:
    """The obstacles' keep-outs from above, with their names."""
    from matplotlib.patches import Circle

    for obstacle in flown.scenario.obstacles:
        centre = (float(obstacle.position[0]), float(obstacle.position[1]))
        axes.add_patch(
            Circle(centre, obstacle.keep_out_m, color=style.GREY, alpha=0.3, linewidth=0)
        )
        axes.annotate(obstacle.name, centre, ha="center", va="center", fontsize=7)


def links(axes: Any, flown: JudgedFlight, tick: int) -> None:
    """A line from every follower to its parent at one tick, from above."""
    scenario, places = flown.scenario, flown.positions[tick]
    for row, uav in enumerate(scenario.uav_ids):
        parent = scenario.parent(uav)
        if parent is not None:
            link = np.stack((places[row], places[scenario.uav_ids.index(parent)]))
            axes.plot(link[:, 0], link[:, 1], color=style.GREY, linewidth=0.8, zorder=1)


def level(axes: Any) -> None:
    """Labels of a view from above, true proportions, the whole panel in use."""
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]")
    axes.set_aspect("equal", adjustable="datalim")
    style.round_ticks(axes.xaxis, 8)
    style.round_ticks(axes.yaxis, 8)
