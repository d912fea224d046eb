"""The formation over time: distances, angles, the leader's yaw. Figs. 9-14 and 26."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from paper.experiment_result import Figure
from paper.figures import panels, style
from paper.figures.panels import DEADLINE_NOTE
from paper.flights import JudgedFlight
from paper.output import ExperimentFolder, time_column
from ptnsbc_core.tasks.formation_tasks import evaluate
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.scenario.constants import reference_offset
from ptnsbc_sim.verdict.deadline import TOLERANCE_M

_SHORTEST_ARM_M = 0.05
_SHOWN = ("paper", "soft")

Flights = Mapping[str, JudgedFlight]
"""By gain profile."""


def _followers(flight: JudgedFlight) -> Iterator[tuple[int, int]]:
    """Row and id of each follower."""
    for row, uav in enumerate(flight.uavs):
        if uav != flight.scenario.leader.id:
            yield row, uav


def _arms(flight: JudgedFlight) -> Iterator[tuple[int, int, int, Array]]:
    """Row, id, parent and position relative to the parent (T, 3) [m] of each UAV that has a parent."""
    positions = flight.positions
    for row, uav in enumerate(flight.uavs):
        parent = flight.scenario.communication.parent(uav)
        if parent is not None:
            yield row, uav, parent, positions[:, row] - positions[:, flight.uavs.index(parent)]


def task_values(flight: JudgedFlight) -> Array:
    """σ (T, N, 3) of (23) at the true positions: distance to the parent [m], angles in XOY and XOZ [rad].

    Zero for the leader. The σ that a UAV computes differs: it is one tick old.
    """
    positions = flight.positions
    leader = positions[:, flight.uavs.index(flight.scenario.leader.id)]
    value = np.zeros(positions.shape)
    for row, uav, parent, _ in _arms(flight):
        j = positions[:, flight.uavs.index(parent)]
        k = leader + reference_offset(flight.scenario, uav)
        for tick in range(positions.shape[0]):
            found = evaluate(TASKS["distance_angles"], positions[tick, row], j[tick], k[tick])
            value[tick, row] = found.value
    return value


def _desired(flight: JudgedFlight) -> Array:
    """Desired σ (N, 3)."""
    return np.stack([agent_config(flight.scenario, uav).desired for uav in flight.uavs])


def _plot_followers(
    row_axes: panels.Row, flight: JudgedFlight, values: Array, desired: Array
) -> None:
    """Values (T, N) of the followers beside the desired ones (N,)."""
    for row, uav in _followers(flight):
        line = style.line(row)
        panels.plot_both(row_axes, flight.times, values[:, row], label=f"UAV {uav}", **line)
        for axes in row_axes:
            axes.axhline(desired[row], color=line["color"], linewidth=0.5, alpha=0.5)
    panels.deadline_line(row_axes[0], flight)


def distances(output: ExperimentFolder, flights: Flights, number: int, suffix: str) -> Figure:
    """Distance of each follower to its parent."""
    drawing = style.figure(80)
    first = flights["paper"]
    curves = time_column(first.times)
    rows = panels.split_rows(
        drawing, panels.profile_titles(_SHOWN), first.scenario.timing.duration_s
    )
    for row_axes, profile in zip(rows, _SHOWN, strict=True):
        flight = flights[profile]
        values = task_values(flight)[:, :, 0]
        _plot_followers(row_axes, flight, values, _desired(flight)[:, 0])
        for row, uav in _followers(flight):
            curves[f"{profile}_uav{uav}_distance_m"] = values[:, row]
    drawing.supylabel("distance to parent [m]", fontsize=8)
    style.legend(drawing, rows[0][0], columns=4)
    caption = f"Distance of each UAV to its parent{suffix}; thin lines: desired, {DEADLINE_NOTE}"
    name = f"fig_{number:02d}_{first.scenario.name}_distance"
    figure = Figure(name, f"Fig. {number}", caption, telling=number == 9)
    return output.write_figure(figure, drawing, curves)


def angles(output: ExperimentFolder, flights: Flights, number: int, suffix: str) -> Figure:
    """The two angles of (23)."""
    drawing = style.figure(140)
    first = flights["paper"]
    curves = time_column(first.times)
    # Of each row: the profile, and the plane, the symbol, the name and the column of the angle.
    kinds = [
        (profile, *angle)
        for profile in _SHOWN
        for angle in (("XOY", "θ", "theta", 1), ("XOZ", "φ", "phi", 2))
    ]
    titles = tuple(
        f"({letter}) {kind[1]}, profile {kind[0]}"
        for letter, kind in zip("abcd", kinds, strict=True)
    )
    rows = panels.split_rows(drawing, titles, first.scenario.timing.duration_s, one_scale=False)
    for row_axes, (profile, _, symbol, angle, column) in zip(rows, kinds, strict=True):
        flight = flights[profile]
        values = unwrapped(flight, column)
        _plot_followers(row_axes, flight, values, _desired(flight)[:, column])
        row_axes[0].set_ylabel(f"{symbol} [rad]")
        for row, uav in _followers(flight):
            curves[f"{profile}_uav{uav}_{angle}_rad"] = values[:, row]
    style.legend(drawing, rows[0][0], columns=4)
    caption = (
        f"Angles of each UAV in XOY and XOZ{suffix}; thin lines: desired, {DEADLINE_NOTE}. The XOZ angle of UAV 3 "
        "begins late: in Table 2 it shares x and z with its parent, and there is none"
    )
    figure = Figure(f"fig_{number:02d}_{first.scenario.name}_angle", f"Fig. {number}", caption)
    return output.write_figure(figure, drawing, curves)


def unwrapped(flight: JudgedFlight, column: int) -> Array:
    """An angle (T, N) [rad] without jumps, ending within half a turn of the desired one.

    NaN where a UAV and its parent coincide in the plane: Table 2 starts UAV 2 and 3 so, and there is no angle.
    """
    value = np.unwrap(task_values(flight)[:, :, column], axis=0)
    value -= 2 * np.pi * np.round((value[-1] - _desired(flight)[:, column]) / (2 * np.pi))
    plane = (0, 1) if column == 1 else (0, 2)
    for row, _, _, arm in _arms(flight):
        value[np.linalg.norm(arm[:, plane], axis=1) < _SHORTEST_ARM_M, row] = np.nan
    return np.asarray(value)


def leader_yaw(output: ExperimentFolder, flights: Flights, number: int, suffix: str) -> Figure:
    """Yaw of the leader under every profile."""
    drawing = style.figure(52)
    scenario = flights["paper"].scenario
    curves = time_column(flights["paper"].times)
    (row_axes,) = panels.split_rows(drawing, ("",), scenario.timing.duration_s)
    for index, (profile, flight) in enumerate(flights.items()):
        leader = flight.uavs.index(scenario.leader.id)
        x, y, z, w = flight.flight.track.odometry[:, leader, 3:7].T
        yaw = np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        line = style.line(index)
        panels.plot_both(row_axes, flight.times, yaw, label=f"profile {profile}", **line)
        curves[f"{profile}_yaw_rad"] = yaw
    row_axes[0].axvline(scenario.gains.attitude.deadline_s, color="black", linewidth=0.6)
    row_axes[0].set_ylabel("yaw of the leader [rad]")
    style.legend(drawing, row_axes[0], columns=3)
    caption = f"Yaw of the leader{suffix}; upright line: deadline of the attitude loop"
    figure = Figure(f"fig_{number:02d}_{scenario.name}_yaw", f"Fig. {number}", caption)
    return output.write_figure(figure, drawing, curves)


def distance_errors(output: ExperimentFolder, flights: Flights, number: int) -> Figure:
    """Distance of all followers to their parents less the desired one."""
    drawing = style.figure(style.stacked_mm(len(flights)))
    first = next(iter(flights.values()))
    titles = panels.profile_titles(flights)
    rows = panels.split_rows(drawing, titles, first.scenario.timing.duration_s)
    curves = time_column(first.times)
    for row_axes, (profile, flight) in zip(rows, flights.items(), strict=True):
        scenario = flight.scenario
        for _, uav, parent, arm in _arms(flight):
            desired = np.linalg.norm(scenario.offset(uav) - scenario.offset(parent))
            error = np.linalg.norm(arm, axis=1) - desired
            panels.plot_both(row_axes, flight.times, error, **panels.uav_line(flight, uav))
            curves[f"{profile}_uav{uav}_distance_error_m"] = error
        for axes in row_axes:
            axes.set_yscale("symlog", linthresh=TOLERANCE_M)
            axes.minorticks_off()
            axes.set_yticks((-1, -0.1, 0, 0.1, 1), ("−1", "−0.1", "0", "0.1", "1"))
            for limit in (-TOLERANCE_M, TOLERANCE_M):
                axes.axhline(limit, color="black", linewidth=0.6, linestyle=":")
        panels.deadline_line(row_axes[0], flight)
    drawing.supylabel("distance to parent less the desired one [m]", fontsize=8)
    style.legend(drawing, rows[0][0], columns=3)
    figure = Figure(
        f"fig_{number}_{first.scenario.name}_distance_error",
        f"Fig. {number}",
        f"Error of the distance to the parent; dotted: 0.05 m, linear within and logarithmic beyond, {DEADLINE_NOTE}",
    )
    return output.write_figure(figure, drawing, curves)
