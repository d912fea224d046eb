"""Trajectories in space and from above: Figs. 5-8, 24, 25 and 33."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import Circle

from paper.experiment_result import Figure
from paper.figures import panels, style
from paper.flights import JudgedFlight
from paper.output import ExperimentFolder, time_column
from ptnsbc_core.types import Array

_TELLING = (5, 6)  # docs/tables.md shows these
LINKS_S = (5.0, 20.0, 35.0, 50.0)  # when lines from above join each UAV to its parent
_MARKS = "dots: starts, squares: the end"
LINKS_NOTE = f"{_MARKS}, grey lines: who follows whom at {', '.join(f'{t:g}' for t in LINKS_S)} s"


def curves(flight: JudgedFlight) -> dict[str, Array]:
    """Time and positions of all UAVs."""
    found = time_column(flight.times)
    for row, uav in enumerate(flight.uavs):
        for axis, letter in enumerate("xyz"):
            found[f"uav{uav}_{letter}_m"] = flight.positions[:, row, axis]
    return found


def in_space(output: ExperimentFolder, flight: JudgedFlight, number: int, subject: str) -> Figure:
    """Trajectories in 3-D."""
    large = panels.is_large(flight)
    drawing = style.figure(84 if large else 80)
    # The axes fill the figure below its legend; the automatic layout ignores 3-D labels.
    drawing.set_layout_engine("none")
    axes = drawing.add_axes((-0.04, 0.09, 0.94, 0.78), projection="3d")
    sizes = (4, 6) if large else (8, 10)
    for row, uav in enumerate(flight.uavs):
        path, look = flight.positions[:, row], panels.uav_line(flight, uav)
        axes.plot(*path.T, **look)
        for end, size, marker in zip((path[0], path[-1]), sizes, "os", strict=True):
            axes.scatter(*end, color=look["color"], s=size, marker=marker, depthshade=False)
    _draw_spheres(axes, flight)
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]", zlabel="z (up) [m]")
    limits = (axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d())
    axes.set_box_aspect([np.ptp(limit) for limit in limits], zoom=0.96)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        style.round_ticks(axis, 5)
        axis.labelpad = 0
        axis.set_tick_params(pad=-1)
    drawing.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=3)
    note = _MARKS + (", grey: keep-out spheres" if flight.scenario.world.bodies else "")
    figure = _figure(flight, number, "3d", f"Trajectories {subject}; {note}", number in _TELLING)
    return output.write_figure(figure, drawing, curves(flight))


def _figure(flight: JudgedFlight, number: int, end: str, caption: str, telling: bool) -> Figure:
    name = f"fig_{number:02d}_{flight.scenario.name}_{end}"
    return Figure(name, f"Fig. {number}", caption, telling)


def _draw_spheres(axes: Any, flight: JudgedFlight) -> None:
    """The obstacles' keep-outs in 3-D."""
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)])
    for obstacle in flight.scenario.world.bodies:
        x, y, z = obstacle.position[:, None, None] + obstacle.keep_out_m * ball
        axes.plot_surface(x, y, z, color=style.GREY, alpha=0.3, linewidth=0)


def from_above(
    output: ExperimentFolder, flight: JudgedFlight, number: int, subject: str, telling: bool = False
) -> Figure:
    """Trajectories in the X-Y plane; in a large formation without the links between UAVs."""
    drawing = style.figure(96)
    axes = drawing.add_subplot()
    draw_from_above(axes, flight)
    style.legend(drawing, axes, columns=3)
    if panels.is_large(flight):
        note = f"{_MARKS}, grey: keep-out spheres"
    elif flight.scenario.world.bodies:
        note = f"{LINKS_NOTE}, grey discs: keep-out spheres, which paths across them pass above or below"
    else:
        note = LINKS_NOTE
    telling = telling or number in _TELLING
    figure = _figure(flight, number, "xy", f"Trajectories {subject}; {note}", telling)
    return output.write_figure(figure, drawing, curves(flight))


def draw_from_above(axes: Any, flight: JudgedFlight) -> None:
    """Paths, obstacles, starts, ends and the formation at a few instants, in true proportions."""
    for obstacle in flight.scenario.world.bodies:
        centre = (float(obstacle.position[0]), float(obstacle.position[1]))
        disc = Circle(centre, obstacle.keep_out_m, color=style.GREY, alpha=0.3, linewidth=0)
        axes.add_patch(disc)
        axes.annotate(obstacle.name, centre, ha="center", va="center", fontsize=7)
    large = panels.is_large(flight)
    for seconds in () if large else LINKS_S:
        draw_links(axes, flight, int(np.argmin(np.abs(flight.times - seconds))))
    sizes = (2, 2.5) if large else (3, 3)
    for row, uav in enumerate(flight.uavs):
        path, look = flight.positions[:, row], panels.uav_line(flight, uav)
        axes.plot(path[:, 0], path[:, 1], **look)
        for end, size, marker in zip((path[0], path[-1]), sizes, "os", strict=True):
            axes.plot(*end[:2], marker=marker, color=look["color"], markersize=size)
    axes.set(xlabel="x (east) [m]", ylabel="y (north) [m]")
    axes.set_aspect("equal", adjustable="datalim")
    style.round_ticks(axes.xaxis, 8)
    style.round_ticks(axes.yaxis, 8)


def draw_links(axes: Any, flight: JudgedFlight, tick: int) -> None:
    """A line from every follower to its parent at one tick, from above."""
    positions = flight.positions[tick]
    for row, uav in enumerate(flight.uavs):
        parent = flight.scenario.communication.parent(uav)
        if parent is not None:
            link = np.stack((positions[row], positions[flight.uavs.index(parent)]))
            axes.plot(link[:, 0], link[:, 1], color=style.GREY, linewidth=0.8, zorder=1)
