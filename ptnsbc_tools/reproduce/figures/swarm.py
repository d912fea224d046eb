"""Twenty UAVs in one figure: coloured by the chain they belong to. Figs. 24-31."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.figures.inputs import INPUT_LABEL, hover, sheet
from ptnsbc_tools.reproduce.figures.paths import (
    columns,
    discs,
    level,
    space,
    spheres,
    tidy_3d,
    uav_label,
)
from ptnsbc_tools.reproduce.figures.shape import DEADLINE_NOTE, deadline, panels
from ptnsbc_tools.reproduce.flights import JudgedFlight
from ptnsbc_tools.verdict.tolerances import TOLERANCE_M
from ptnsbc_tools.verdict.windows import ancestors

LIMIT_N = 500.0  # what the paper says no input exceeds
_THIN, _THICK = 0.6, 1.2
_ROW_MM, _REST_MM = 32.0, 20.0  # of a figure with panels one below the other


def _titles(flights: Mapping[str, JudgedFlight]) -> tuple[str, ...]:
    return tuple(f"({letter}) profile {name}" for letter, name in zip("abc", flights, strict=False))


def chain(flown: JudgedFlight, uav: int) -> int:
    """The leader's child that a UAV follows, itself or through others; 0 for the leader."""
    above = ancestors(flown.scenario, uav)  # itself first, the leader last
    return above[-2] if len(above) > 1 else 0


def _look(flown: JudgedFlight, uav: int) -> dict[str, Any]:
    """Colour by chain, the leader black and thick, one label per chain."""
    found = chain(flown, uav)
    if found == 0:
        return {"color": "black", "linewidth": _THICK, "label": f"UAV {uav} (leader)"}
    heads = [one for one in flown.scenario.followers if chain(flown, one) == one]
    index = heads.index(found)
    look = {**style.look(index), "linewidth": _THIN}
    return {**look, "label": f"chain of UAV {found}"} if uav == found else look


def in_space(workshop: ExperimentFolder, flown: JudgedFlight, number: int) -> Figure:
    """Trajectories in 3-D."""
    made = style.figure(84)
    axes = space(made)
    for row, uav in enumerate(flown.scenario.uav_ids):
        path, look = flown.positions[:, row], _look(flown, uav)
        axes.plot(*path.T, **look)
        axes.scatter(*path[0], color=look["color"], s=4, marker="o", depthshade=False)
        axes.scatter(*path[-1], color=look["color"], s=6, marker="s", depthshade=False)
    spheres(axes, flown)
    tidy_3d(axes)
    made.legend(*axes.get_legend_handles_labels(), loc="upper center", ncols=3)
    name = f"fig_{number}_{flown.scenario.name}_3d"
    workshop.figure(name, made, columns(flown))
    caption = (
        "Trajectories of 20 UAVs in space; dots: starts, squares: the end, grey: keep-out spheres"
    )
    return Figure(name, f"Fig. {number}", caption)


def from_above(workshop: ExperimentFolder, flown: JudgedFlight, number: int) -> Figure:
    """Trajectories in the X-Y plane."""
    made = style.figure(96)
    axes = made.add_subplot()
    discs(axes, flown)
    for row, uav in enumerate(flown.scenario.uav_ids):
        path, look = flown.positions[:, row], _look(flown, uav)
        axes.plot(path[:, 0], path[:, 1], **look)
        axes.plot(*path[0, :2], marker="o", color=look["color"], markersize=2)
        axes.plot(*path[-1, :2], marker="s", color=look["color"], markersize=2.5)
    level(axes)
    style.legend(made, axes, columns=3)
    name = f"fig_{number}_{flown.scenario.name}_xy"
    workshop.figure(name, made, columns(flown))
    caption = (
        "Trajectories of 20 UAVs from above; dots: starts, squares: the end, grey: keep-out spheres"
    )
    return Figure(name, f"Fig. {number}", caption, telling=True)


def distance_errors(flown: JudgedFlight) -> Array:
    """Distance to the parent less the desired one (T, N) [m], zero for the leader."""
    scenario, places = flown.scenario, flown.positions
    found = np.zeros(places.shape[:2])
    for row, uav in enumerate(scenario.uav_ids):
        parent = scenario.parent(uav)
        if parent is not None:
            arm = places[:, row] - places[:, scenario.uav_ids.index(parent)]
            wanted = np.linalg.norm(scenario.offset(uav) - scenario.offset(parent))
            found[:, row] = np.linalg.norm(arm, axis=1) - wanted
    return found


def distance_error(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int
) -> Figure:
    """Distance errors of all followers."""
    made = style.figure(_ROW_MM * len(flights) + _REST_MM)
    some = next(iter(flights.values()))
    rows = panels(made, len(flights), _titles(flights), some.scenario.duration_s)
    found = {"time_s": times_column(some.times)}
    for axes, (profile, flown) in zip(rows, flights.items(), strict=True):
        errors = distance_errors(flown)
        for row, uav in enumerate(flown.scenario.uav_ids):
            if uav == flown.scenario.leader_id:
                continue
            for one in axes:
                one.plot(flown.times, errors[:, row], **_look(flown, uav))
            found[f"{profile}_uav{uav}_distance_error_m"] = errors[:, row]
        for one in axes:
            one.set_yscale("symlog", linthresh=TOLERANCE_M)
            one.minorticks_off()
            one.set_yticks((-1, -0.1, 0, 0.1, 1), ("−1", "−0.1", "0", "0.1", "1"))
            for limit in (-TOLERANCE_M, TOLERANCE_M):
                one.axhline(limit, color="black", linewidth=0.6, linestyle=":")
        deadline(axes[0], flown)
    made.supylabel("distance to parent less the desired one [m]", fontsize=8)
    style.legend(made, rows[0][0], columns=3)
    name = f"fig_{number}_{some.scenario.name}_distance_error"
    workshop.figure(name, made, found)
    return Figure(
        name,
        f"Fig. {number}",
        f"Error of the distance to the parent; dotted: 0.05 m, linear within and logarithmic beyond, {DEADLINE_NOTE}",
    )


def inputs(workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int) -> Figure:
    """Inputs of all UAVs, beside the limit that the paper names."""
    made = style.figure(_ROW_MM * len(flights) + _REST_MM)
    some = next(iter(flights.values()))
    rows = panels(made, len(flights), _titles(flights), some.scenario.duration_s)
    for axes, flown in zip(rows, flights.values(), strict=True):
        for one in axes:
            for row, uav in enumerate(flown.scenario.uav_ids):
                one.plot(flown.times, flown.inputs[:, row], **_look(flown, uav))
            style.log_scale(one)
            one.axhline(LIMIT_N, color="black", linewidth=0.8, linestyle="--")
            hover(one, flown)
        deadline(axes[0], flown)
        axes[0].set_ylabel(INPUT_LABEL)
    style.legend(made, rows[0][0], columns=3)
    name = f"fig_{number}_{some.scenario.name}_input"
    workshop.figure(name, made, sheet(flights, some.scenario.duration_s))
    caption = f"Input of 20 UAVs; dashed: 500 N, dotted: the weight, {DEADLINE_NOTE}"
    return Figure(name, f"Fig. {number}", caption, telling=True)


def five(
    workshop: ExperimentFolder,
    flights: Mapping[str, JudgedFlight],
    number: int,
    uavs: tuple[int, ...],
) -> Figure:
    """Inputs of five of the UAVs."""
    made = style.figure(_ROW_MM * len(flights) + _REST_MM)
    some = next(iter(flights.values()))
    end_s = some.scenario.duration_s
    rows = panels(made, len(flights), _titles(flights), end_s, one_scale=False)
    found = {"time_s": times_column(some.times)}
    for axes, (profile, flown) in zip(rows, flights.items(), strict=True):
        for index, uav in enumerate(uavs):
            row = flown.scenario.uav_ids.index(uav)
            for one in axes:
                values = flown.inputs[:, row]
                one.plot(flown.times, values, label=uav_label(flown, uav), **style.look(index))
            found[f"{profile}_uav{uav}_input_n_nm"] = flown.inputs[:, row]
        for one in axes:
            hover(one, flown)
        deadline(axes[0], flown)
        axes[0].set_ylabel(INPUT_LABEL)
    style.legend(made, rows[0][0], columns=3)
    name = f"fig_{number}_{some.scenario.name}_input_{uavs[0]}_{uavs[-1]}"
    workshop.figure(name, made, found)
    note = f"each profile on a scale of its own; dotted: the weight, {DEADLINE_NOTE}"
    caption = f"Input of UAV {uavs[0]} to UAV {uavs[-1]}, {note}"
    return Figure(name, f"Fig. {number}", caption)
