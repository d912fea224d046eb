"""Inputs and energy over time: Figs. 15-23, 27-31 and A2."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from paper.claims import PRINTED
from paper.experiment_result import Figure
from paper.figures import panels, style
from paper.figures.panels import DEADLINE_NOTE
from paper.flights import JudgedFlight
from paper.output import Curves, ExperimentFolder, time_column
from ptnsbc_core.types import Array

PAPER_LIMIT_N = 500.0  # the paper says that no input exceeds it
INPUT_LABEL = "‖u‖ [N, N m]"
_TIME_LABEL = "time after the epoch [s]"
_SHOWN = ("paper", "soft")
_COMPARED_S = 6.0
_BEGINNING_S = 3.0
_LEAST = 1.0  # smallest input on a logarithmic axis

Flights = Mapping[str, JudgedFlight]
"""By gain profile or by law."""


def _curves(flights: Flights, end_s: float, uavs: Iterable[int] | None = None) -> Curves:
    """Inputs until `end_s`, of some UAVs or of all."""
    first = next(iter(flights.values()))
    chosen = first.times < end_s - 1e-9
    found = time_column(first.times[chosen])
    for profile, flight in flights.items():
        for uav in uavs or flight.uavs:
            row = flight.uavs.index(uav)
            found[f"{profile}_uav{uav}_input_n_nm"] = flight.inputs[chosen, row]
    return found


def _plot_inputs(axes: Any, flight: JudgedFlight, chosen: NDArray[np.bool_] | None = None) -> None:
    """Inputs of every UAV, at all times or at those chosen."""
    times, inputs = flight.times, flight.inputs
    if chosen is not None:
        times, inputs = times[chosen], inputs[chosen]
    for row, uav in enumerate(flight.uavs):
        axes.plot(times, inputs[:, row], **panels.uav_line(flight, uav))


def whole_flight(output: ExperimentFolder, flights: Flights, number: int, suffix: str) -> Figure:
    """Inputs of the whole flight."""
    shown = {profile: flights[profile] for profile in _SHOWN}
    scenario = flights["paper"].scenario
    drawing = style.figure(80)
    rows = panels.split_rows(drawing, panels.profile_titles(shown), scenario.timing.duration_s)
    for row_axes, flight in zip(rows, shown.values(), strict=True):
        for axes in row_axes:
            _plot_inputs(axes, flight)
            panels.weight_line(axes, flight)
        panels.deadline_line(row_axes[0], flight)
        row_axes[0].set_ylabel(INPUT_LABEL)
    style.legend(drawing, rows[0][0], columns=3)
    caption = f"Input of the UAVs{suffix}; dotted: the weight, {DEADLINE_NOTE}"
    figure = Figure(f"fig_{number:02d}_{scenario.name}_input", f"Fig. {number}", caption)
    return output.write_figure(figure, drawing, _curves(shown, scenario.timing.duration_s))


def first_second(output: ExperimentFolder, flights: Flights, number: int, suffix: str) -> Figure:
    """Inputs of the first second."""
    shown = {profile: flights[profile] for profile in _SHOWN}
    drawing = style.figure(80)
    grid = drawing.subplots(2, 1, sharex=True, sharey=True)
    titles = panels.profile_titles(shown)
    for axes, flight, title in zip(grid, shown.values(), titles, strict=True):
        _plot_inputs(axes, flight, flight.times <= 1.0)
        panels.weight_line(axes, flight)
        axes.set_title(title, loc="left")
        axes.set(ylabel=INPUT_LABEL, xlim=(0, 1))
    grid[-1].set_xlabel(_TIME_LABEL)
    style.legend(drawing, grid[0], columns=3)
    caption = f"Input of the UAVs in the first second{suffix}; dotted: the weight"
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_first_second"
    figure = Figure(name, f"Fig. {number}", caption, telling=number == 17)
    return output.write_figure(figure, drawing, _curves(shown, 1.0))


def with_limit(output: ExperimentFolder, flights: Flights, number: int) -> Figure:
    """Inputs of all UAVs, beside the limit that the paper names."""
    drawing = style.figure(style.stacked_mm(len(flights)))
    scenario = next(iter(flights.values())).scenario
    rows = panels.split_rows(drawing, panels.profile_titles(flights), scenario.timing.duration_s)
    for row_axes, flight in zip(rows, flights.values(), strict=True):
        for axes in row_axes:
            _plot_inputs(axes, flight)
            style.log_scale(axes)
            axes.axhline(PAPER_LIMIT_N, color="black", linewidth=0.8, linestyle="--")
            panels.weight_line(axes, flight)
        panels.deadline_line(row_axes[0], flight)
        row_axes[0].set_ylabel(INPUT_LABEL)
    style.legend(drawing, rows[0][0], columns=3)
    caption = f"Input of 20 UAVs; dashed: 500 N, dotted: the weight, {DEADLINE_NOTE}"
    figure = Figure(f"fig_{number}_{scenario.name}_input", f"Fig. {number}", caption, telling=True)
    return output.write_figure(figure, drawing, _curves(flights, scenario.timing.duration_s))


def five_uavs(
    output: ExperimentFolder, flights: Flights, number: int, uavs: tuple[int, ...]
) -> Figure:
    """Inputs of five of the UAVs."""
    drawing = style.figure(style.stacked_mm(len(flights)))
    scenario = next(iter(flights.values())).scenario
    end_s, titles = scenario.timing.duration_s, panels.profile_titles(flights)
    rows = panels.split_rows(drawing, titles, end_s, one_scale=False)
    for row_axes, flight in zip(rows, flights.values(), strict=True):
        for index, uav in enumerate(uavs):
            values = flight.inputs[:, flight.uavs.index(uav)]
            line = {"label": panels.uav_label(flight, uav), **style.line(index)}
            panels.plot_both(row_axes, flight.times, values, **line)
        for axes in row_axes:
            panels.weight_line(axes, flight)
        panels.deadline_line(row_axes[0], flight)
        row_axes[0].set_ylabel(INPUT_LABEL)
    style.legend(drawing, rows[0][0], columns=3)
    note = f"each profile on a scale of its own; dotted: the weight, {DEADLINE_NOTE}"
    caption = f"Input of UAV {uavs[0]} to UAV {uavs[-1]}, {note}"
    name = f"fig_{number}_{scenario.name}_input_{uavs[0]}_{uavs[-1]}"
    figure = Figure(name, f"Fig. {number}", caption)
    return output.write_figure(figure, drawing, _curves(flights, end_s, uavs))


def compared_pair(
    output: ExperimentFolder, flights: Flights, law: str, numbers: tuple[int, int]
) -> tuple[Figure, Figure]:
    """Ours as printed and one baseline, in two figures with the same axes."""
    both = (flights[PRINTED], flights[law])
    top = 1.4 * max(float(one.inputs[one.times <= _COMPARED_S].max()) for one in both)
    rest = f"logarithmic, nothing below {_LEAST:g} shown; dotted: the weight, {DEADLINE_NOTE}"
    what = ("ours as printed, no command filter", law)
    captions = [
        f"Input of the UAVs, {what[k]}, on the axes of Fig. {numbers[1 - k]}; {rest}"
        for k in (0, 1)
    ]
    first, second = (
        _compared(output, both[k], top, numbers[k], ("ours", law)[k], captions[k]) for k in (0, 1)
    )
    return first, second


def _compared(
    output: ExperimentFolder, flight: JudgedFlight, top: float, number: int, end: str, caption: str
) -> Figure:
    """Inputs of every UAV until shortly after the deadline."""
    drawing = style.figure(62)
    axes = drawing.add_subplot()
    shown = flight.times <= _COMPARED_S
    curves = time_column(flight.times[shown])
    for row, uav in enumerate(flight.uavs):
        values = flight.inputs[shown, row]
        line = panels.uav_line(flight, uav)
        axes.plot(flight.times[shown], np.maximum(values, _LEAST), **line)
        curves[f"uav{uav}_input_n_nm"] = values
    style.log_scale(axes)
    panels.weight_line(axes, flight)
    panels.deadline_line(axes, flight)
    axes.set(xlabel=_TIME_LABEL, ylabel=INPUT_LABEL)
    axes.set(xlim=(0, _COMPARED_S), ylim=(_LEAST, top))
    style.legend(drawing, axes, columns=3)
    figure = Figure(f"fig_{number}_paper_5_free_{end}", f"Fig. {number}", caption)
    return output.write_figure(figure, drawing, curves)


def all_laws(output: ExperimentFolder, comparisons: Mapping[str, Flights]) -> Figure:
    """The largest input of any UAV for every law, a panel for each comparison."""
    drawing = style.figure(52 * len(comparisons) + 12)
    grid = drawing.subplots(len(comparisons), 1, sharex=True, sharey=True)
    curves: dict[str, Array] = {}
    first, black = next(iter(comparisons.values())), ""
    for axes, (title, flights), letter in zip(grid, comparisons.items(), "abc", strict=True):
        for index, (law, flight) in enumerate(flights.items()):
            shown = flight.times <= _BEGINNING_S
            worst = flight.inputs[shown].max(axis=1)
            curves = curves or time_column(flight.times[shown])
            curves[f"{letter}_{law}_input_n_nm"] = worst
            axes.plot(flight.times[shown], worst, label=law, **style.line(index))
        style.log_scale(axes)
        black += "".join(f"; ({letter}) black: {law}" for law in flights if law not in first)
        panels.weight_line(axes, next(iter(flights.values())))
        axes.set_title(f"({letter}) {title}", loc="left")
        axes.set(ylabel=INPUT_LABEL, xlim=(0, _BEGINNING_S))
    grid[-1].set_xlabel(_TIME_LABEL)
    style.legend(drawing, grid[0], columns=2)
    caption = f"Largest input of any UAV by law; dotted: the weight{black}"
    figure = Figure("fig_a2_all_laws", "Fig. A2", caption, telling=True)
    return output.write_figure(figure, drawing, curves)


def _spent(flight: JudgedFlight, beyond_hover: bool) -> Array:
    """(54) from the epoch until t (T, N) [N^2 s]; an input acts until the next one."""
    wrench = flight.flight.track.wrench
    force = flight.force - (flight.weight_n if beyond_hover else 0.0)
    rate = force**2 + np.sum(wrench[:, :, 3:] ** 2, axis=2)
    return np.asarray(np.cumsum(rate, axis=0) * flight.scenario.timing.dt_ns * 1e-9)


def energy(output: ExperimentFolder, flights: Flights) -> Figure:
    """Energy of each UAV under two profiles, with what hovering costs and without it."""
    drawing = style.figure(96)
    grid = drawing.subplots(2, 2, sharex=True, sharey="row")
    curves = time_column(next(iter(flights.values())).times)
    for column, (profile, flight) in enumerate(flights.items()):
        for row, what in enumerate(("with_hover", "beyond_hover")):
            spent, axes = _spent(flight, beyond_hover=row == 1), grid[row, column]
            for index, uav in enumerate(flight.uavs):
                axes.plot(flight.times, spent[:, index], **panels.uav_line(flight, uav))
                curves[f"{profile}_uav{uav}_{what}_n2s"] = spent[:, index]
            axes.set_title(f"({'abcd'[2 * row + column]}) profile {profile}", loc="left")
    grid[0, 0].set_ylabel("energy (54) [N² s]")
    grid[1, 0].set_ylabel("beyond hover [N² s]")
    drawing.supxlabel(_TIME_LABEL, fontsize=8)
    style.legend(drawing, grid[0, 0], columns=3)
    caption = "Energy (54) of each UAV; (a, b) as printed, (c, d) without the weight"
    figure = Figure("fig_23_paper_5_energy", "Fig. 23", caption)
    return output.write_figure(figure, drawing, curves)
