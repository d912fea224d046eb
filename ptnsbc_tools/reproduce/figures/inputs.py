"""Inputs over time: Figs. 15-18 and 27-31."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ptnsbc_tools.reproduce.experiment_folder import Curves, ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.figures.paths import uav_label
from ptnsbc_tools.reproduce.figures.shape import DEADLINE_NOTE, deadline, panels
from ptnsbc_tools.reproduce.flights import JudgedFlight

INPUT_LABEL = "‖u‖ [N, N m]"
_SHOWN = ("paper", "soft")


def sheet(flights: Mapping[str, JudgedFlight], end_s: float) -> Curves:
    """Inputs of every UAV until `end_s`."""
    some = next(iter(flights.values()))
    chosen = some.times < end_s - 1e-9
    found = {"time_s": times_column(some.times[chosen])}
    for key, flown in flights.items():
        for row, uav in enumerate(flown.scenario.uav_ids):
            found[f"{key}_uav{uav}_input_n_nm"] = flown.inputs[chosen, row]
    return found


def hover(axes: Any, flown: JudgedFlight) -> None:
    """A line at the weight."""
    axes.axhline(flown.weight_n, color="black", linewidth=0.6, linestyle=":")


def whole(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int, suffix: str
) -> Figure:
    """Inputs of the whole flight."""
    shown = {profile: flights[profile] for profile in _SHOWN}
    made = style.figure(80)
    end_s = flights["paper"].scenario.duration_s
    rows = panels(made, 2, ("(a) profile paper", "(b) profile soft"), end_s)
    for axes, flown in zip(rows, shown.values(), strict=True):
        for one in axes:
            for row, uav in enumerate(flown.scenario.uav_ids):
                label = uav_label(flown, uav)
                one.plot(flown.times, flown.inputs[:, row], label=label, **style.look(row))
            hover(one, flown)
        deadline(axes[0], flown)
        axes[0].set_ylabel(INPUT_LABEL)
    style.legend(made, rows[0][0], columns=3)
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_input"
    workshop.figure(name, made, sheet(shown, end_s))
    caption = f"Input of the UAVs{suffix}; dotted: the weight, {DEADLINE_NOTE}"
    return Figure(name, f"Fig. {number}", caption)


def first_second(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int, suffix: str
) -> Figure:
    """Inputs of the first second."""
    shown = {profile: flights[profile] for profile in _SHOWN}
    made = style.figure(80)
    grid = made.subplots(2, 1, sharex=True, sharey=True)
    for axes, (profile, flown), letter in zip(grid, shown.items(), "ab", strict=True):
        for row, uav in enumerate(flown.scenario.uav_ids):
            first = flown.times <= 1.0
            label = uav_label(flown, uav)
            axes.plot(flown.times[first], flown.inputs[first, row], label=label, **style.look(row))
        hover(axes, flown)
        axes.set_title(f"({letter}) profile {profile}", loc="left")
        axes.set(ylabel=INPUT_LABEL, xlim=(0, 1))
    grid[-1].set_xlabel("time after the epoch [s]")
    style.legend(made, grid[0], columns=3)
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_first_second"
    workshop.figure(name, made, sheet(shown, 1.0))
    return Figure(
        name, f"Fig. {number}", f"Input of the UAVs in the first second{suffix}; dotted: the weight",
        telling=number == 17,
    )  # fmt: skip
