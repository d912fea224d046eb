"""Energy (54) over time, with hover and beyond it: Fig. 23."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.figures.paths import uav_label
from ptnsbc_tools.reproduce.flights import JudgedFlight


def spent(flown: JudgedFlight, beyond_hover: bool) -> Array:
    """(54) from the epoch until t (T, N) [N^2 s]; an input acts until the next one."""
    wrench = flown.flight.track.wrench
    force = flown.force - (flown.weight_n if beyond_hover else 0.0)
    rate = force**2 + np.sum(wrench[:, :, 3:] ** 2, axis=2)
    return np.asarray(np.cumsum(rate, axis=0) * flown.scenario.dt_ns * 1e-9)


def _panel(axes: Any, flown: JudgedFlight, beyond_hover: bool) -> Array:
    found = spent(flown, beyond_hover)
    for row, uav in enumerate(flown.scenario.uav_ids):
        axes.plot(flown.times, found[:, row], label=uav_label(flown, uav), **style.look(row))
    return found


def energy(workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight]) -> Figure:
    """Energy of each UAV under two profiles."""
    made = style.figure(96)
    grid = made.subplots(2, 2, sharex=True, sharey="row")
    sheet = {"time_s": times_column(next(iter(flights.values())).times)}
    for column, (profile, flown) in enumerate(flights.items()):
        for row, what in enumerate(("with_hover", "beyond_hover")):
            found = _panel(grid[row, column], flown, beyond_hover=row == 1)
            for index, uav in enumerate(flown.scenario.uav_ids):
                sheet[f"{profile}_uav{uav}_{what}_n2s"] = found[:, index]
            letter = "abcd"[2 * row + column]
            grid[row, column].set_title(f"({letter}) profile {profile}", loc="left")
    grid[0, 0].set_ylabel("energy (54) [N² s]")
    grid[1, 0].set_ylabel("beyond hover [N² s]")
    made.supxlabel("time after the epoch [s]", fontsize=8)
    style.legend(made, grid[0, 0], columns=3)
    name = "fig_23_paper_5_energy"
    workshop.figure(name, made, sheet)
    return Figure(
        name, "Fig. 23", "Energy (54) of each UAV; (a, b) as printed, (c, d) without the weight"
    )
