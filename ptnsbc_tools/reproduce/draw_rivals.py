"""Inputs of ours and of what it is compared with, on the same axes: Figs. 19-22 and A2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce import style
from ptnsbc_tools.reproduce.draw_inputs import INPUT_LABEL, hover
from ptnsbc_tools.reproduce.draw_paths import uav_label
from ptnsbc_tools.reproduce.flights import Flown
from ptnsbc_tools.reproduce.part import Figure
from ptnsbc_tools.reproduce.workshop import Workshop, times_column

SHOWN_S = 6.0
_LEAST = 1.0  # of an input on a logarithmic axis


def _shown(one: Flown) -> NDArray[np.bool_]:
    return np.asarray(one.times <= SHOWN_S)


def pair(
    workshop: Workshop, ours: Flown, rival: Flown, numbers: tuple[int, int], law: str
) -> tuple[Figure, Figure]:
    """Ours and one baseline in two figures with the same axes."""
    top = 1.4 * max(one.inputs[_shown(one)].max() for one in (ours, rival))
    found = []
    for one, number, name, label in (
        (ours, numbers[0], "ours", "ours, profile paper"),
        (rival, numbers[1], law, f"`{law}`"),
    ):
        made = style.figure(62)
        axes = made.add_subplot()
        shown = _shown(one)
        sheet = {"time_s": times_column(one.times[shown])}
        for row, uav in enumerate(one.scenario.uav_ids):
            values = np.maximum(one.inputs[shown, row], _LEAST)
            axes.semilogy(one.times[shown], values, label=uav_label(one, uav), **style.look(row))
            sheet[f"uav{uav}_input_n_nm"] = one.inputs[shown, row]
        hover(axes, one)
        axes.axvline(one.scenario.gains.formation.deadline_s, color="black", linewidth=0.6)
        axes.set(xlabel="time after the epoch [s]", ylabel=INPUT_LABEL)
        axes.set(xlim=(0, SHOWN_S), ylim=(_LEAST, top))
        style.legend(made, axes, columns=3)
        full = f"fig_{number}_paper_5_free_{name}"
        workshop.figure(full, made, sheet)
        caption = f"Input of the UAVs, {label}, on the axes of Fig. {sum(numbers) - number}"
        found.append(Figure(full, f"Fig. {number}", f"{caption}; line: the deadline"))
    return found[0], found[1]


def all_laws(workshop: Workshop, panels: Mapping[str, Mapping[str, Flown]]) -> Figure:
    """The largest input of any UAV for every law, a panel for each way to compare."""
    made = style.figure(52 * len(panels) + 12)
    grid = made.subplots(len(panels), 1, sharex=True, sharey=True)
    sheet: dict[str, Array] = {}
    for axes, (title, flights), letter in zip(grid, panels.items(), "abc", strict=True):
        for index, (law, one) in enumerate(flights.items()):
            shown = _shown(one)
            worst = one.inputs[shown].max(axis=1)
            sheet.setdefault("time_s", times_column(one.times[shown]))
            sheet[f"{letter}_{law}_input_n_nm"] = worst
            axes.semilogy(one.times[shown], worst, label=law, **style.look(index))
        hover(axes, next(iter(flights.values())))
        axes.set_title(f"({letter}) {title}", loc="left")
        axes.set(ylabel=INPUT_LABEL, xlim=(0, SHOWN_S))
    grid[-1].set_xlabel("time after the epoch [s]")
    _legend(made, grid)
    name = "fig_a2_all_laws"
    workshop.figure(name, made, sheet)
    return Figure(
        name,
        "Fig. A2",
        "Largest input of any UAV by law; dotted: the weight",
        telling=True,
    )


def _legend(made: Any, grid: Any) -> None:
    style.legend(made, grid[0], columns=2)
