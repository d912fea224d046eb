"""Inputs of ours and of what it is compared with, on the same axes: Figs. 19-22 and A2."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.figures.inputs import INPUT_LABEL, hover
from ptnsbc_tools.reproduce.figures.paths import uav_label
from ptnsbc_tools.reproduce.figures.shape import DEADLINE_NOTE
from ptnsbc_tools.reproduce.flights import JudgedFlight
from ptnsbc_tools.reproduce.rivalry import PRINTED

SHOWN_S = 6.0
_BEGINNING_S = 3.0
_LEAST = 1.0  # of an input on a logarithmic axis


def _shown(one: JudgedFlight) -> NDArray[np.bool_]:
    return np.asarray(one.times <= SHOWN_S)


def pair(
    workshop: ExperimentFolder,
    flights: Mapping[str, JudgedFlight],
    law: str,
    numbers: tuple[int, int],
) -> tuple[Figure, Figure]:
    """Ours, as printed, and one baseline in two figures with the same axes."""
    both = (flights[PRINTED], flights[law])
    top = 1.4 * max(float(one.inputs[_shown(one)].max()) for one in both)
    first = _one(workshop, both[0], top, f"fig_{numbers[0]}_paper_5_free_ours")
    second = _one(workshop, both[1], top, f"fig_{numbers[1]}_paper_5_free_{law}")
    rest = f"logarithmic, nothing below {_LEAST:g} shown; dotted: the weight, {DEADLINE_NOTE}"
    return (
        Figure(
            first,
            f"Fig. {numbers[0]}",
            f"Input of the UAVs, ours as printed, no command filter, on the axes of Fig. {numbers[1]}; {rest}",
        ),
        Figure(
            second,
            f"Fig. {numbers[1]}",
            f"Input of the UAVs, {law}, on the axes of Fig. {numbers[0]}; {rest}",
        ),
    )


def _one(workshop: ExperimentFolder, one: JudgedFlight, top: float, name: str) -> str:
    """Inputs of every UAV until shortly after the deadline."""
    made = style.figure(62)
    axes = made.add_subplot()
    shown = _shown(one)
    sheet = {"time_s": times_column(one.times[shown])}
    for row, uav in enumerate(one.scenario.uav_ids):
        values = np.maximum(one.inputs[shown, row], _LEAST)
        axes.plot(one.times[shown], values, label=uav_label(one, uav), **style.look(row))
        sheet[f"uav{uav}_input_n_nm"] = one.inputs[shown, row]
    style.log_scale(axes)
    hover(axes, one)
    axes.axvline(one.scenario.gains.formation.deadline_s, color="black", linewidth=0.6)
    axes.set(xlabel="time after the epoch [s]", ylabel=INPUT_LABEL)
    axes.set(xlim=(0, SHOWN_S), ylim=(_LEAST, top))
    style.legend(made, axes, columns=3)
    workshop.figure(name, made, sheet)
    return name


def all_laws(
    workshop: ExperimentFolder, panels: Mapping[str, Mapping[str, JudgedFlight]]
) -> Figure:
    """The largest input of any UAV for every law, a panel for each way to compare."""
    made = style.figure(52 * len(panels) + 12)
    grid = made.subplots(len(panels), 1, sharex=True, sharey=True)
    sheet: dict[str, Array] = {}
    first, odd = next(iter(panels.values())), ""
    for axes, (title, flights), letter in zip(grid, panels.items(), "abc", strict=True):
        for index, (law, one) in enumerate(flights.items()):
            shown = one.times <= _BEGINNING_S
            worst = one.inputs[shown].max(axis=1)
            sheet.setdefault("time_s", times_column(one.times[shown]))
            sheet[f"{letter}_{law}_input_n_nm"] = worst
            axes.plot(one.times[shown], worst, label=law, **style.look(index))
        style.log_scale(axes)
        odd += "".join(f"; ({letter}) black: {law}" for law in flights if law not in first)
        hover(axes, next(iter(flights.values())))
        axes.set_title(f"({letter}) {title}", loc="left")
        axes.set(ylabel=INPUT_LABEL, xlim=(0, _BEGINNING_S))
    grid[-1].set_xlabel("time after the epoch [s]")
    style.legend(made, grid[0], columns=2)
    name = "fig_a2_all_laws"
    workshop.figure(name, made, sheet)
    return Figure(
        name,
        "Fig. A2",
        f"Largest input of any UAV by law; dotted: the weight{odd}",
        telling=True,
    )
