"""The formation over time: distances, angles, the leader's yaw. Figs. 9-14."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ptnsbc_core.tasks.registry import evaluate
from ptnsbc_core.types import TASK_DISTANCE_ANGLES, Array
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.scenario.build import reference_offset
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Figure
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.flights import JudgedFlight

SPLIT_S = 6.0
DEADLINE_NOTE = "upright line: the deadline"
_SHORTEST_ARM_M = 0.05
_SHOWN = ("paper", "soft")


def task_values(flown: JudgedFlight) -> Array:
    """σ (T, N, 3) of (23) where the UAVs are: distance to the parent [m], angles in XOY and XOZ [rad].

    Zero for the leader. Not the σ that a UAV computes: that one is a tick old.
    """
    scenario, places = flown.scenario, flown.positions
    leader = places[:, scenario.uav_ids.index(scenario.leader_id)]
    value = np.zeros(places.shape)
    for row, uav in enumerate(scenario.uav_ids):
        parent = scenario.parent(uav)
        if parent is None:
            continue
        above = places[:, scenario.uav_ids.index(parent)]
        behind = leader + reference_offset(scenario, uav)
        for tick in range(places.shape[0]):
            found = evaluate(TASK_DISTANCE_ANGLES, places[tick, row], above[tick], behind[tick])
            value[tick, row] = found.value
    return value


def desired_values(flown: JudgedFlight) -> Array:
    """Desired σ (N, 3)."""
    scenario = flown.scenario
    return np.stack([agent_config(scenario, uav).desired for uav in scenario.uav_ids])


def panels(
    made: Any, rows: int, titles: tuple[str, ...], end_s: float, *, one_scale: bool = True
) -> list[tuple[Any, Any]]:
    """Per row a panel of the approach and one of the rest; the same scale up and down, or per row."""
    grid = made.add_gridspec(rows, 2)
    found: list[tuple[Any, Any]] = []
    for row in range(rows):
        first = found[0][0] if found and one_scale else None
        left = made.add_subplot(grid[row, 0], sharey=first)
        right = made.add_subplot(grid[row, 1], sharey=left)
        right.tick_params(labelleft=False)
        left.set_xlim(0, SPLIT_S)
        right.set_xlim(SPLIT_S, end_s)
        left.set_title(titles[row], loc="left")
        style.round_ticks(left.xaxis, 6)
        style.round_ticks(left.yaxis, 5)
        if row < rows - 1:
            left.tick_params(labelbottom=False)
            right.tick_params(labelbottom=False)
        found.append((left, right))
    made.supxlabel("time after the epoch [s]", fontsize=8)
    return found


def deadline(axes: Any, flown: JudgedFlight) -> None:
    """A line at the deadline."""
    axes.axvline(flown.scenario.gains.formation.deadline_s, color="black", linewidth=0.6)


def _both(axes: tuple[Any, Any], times: Array, values: Array, **look: Any) -> None:
    for one in axes:
        one.plot(times, values, **look)


def _curves(axes: tuple[Any, Any], flown: JudgedFlight, values: Array, desired: Array) -> None:
    """Values (T, N) of the followers beside the desired ones (N,)."""
    for row, uav in enumerate(flown.scenario.uav_ids):
        if uav == flown.scenario.leader_id:
            continue
        _both(axes, flown.times, values[:, row], label=f"UAV {uav}", **style.look(row))
        for one in axes:
            one.axhline(desired[row], color=style.look(row)["color"], linewidth=0.5, alpha=0.5)
    deadline(axes[0], flown)


def distances(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int, suffix: str
) -> Figure:
    """Distance of each follower to its parent."""
    made = style.figure(80)
    sheet = {"time_s": times_column(flights["paper"].times)}
    titles = ("(a) profile paper", "(b) profile soft")
    rows = panels(made, 2, titles, flights["paper"].scenario.duration_s)
    for axes, profile in zip(rows, _SHOWN, strict=True):
        flown = flights[profile]
        value, desired = task_values(flown)[:, :, 0], desired_values(flown)[:, 0]
        _curves(axes, flown, value, desired)
        for row, uav in enumerate(flown.scenario.uav_ids):
            if uav != flown.scenario.leader_id:
                sheet[f"{profile}_uav{uav}_distance_m"] = value[:, row]
    made.supylabel("distance to parent [m]", fontsize=8)
    style.legend(made, rows[0][0], columns=4)
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_distance"
    workshop.figure(name, made, sheet)
    caption = f"Distance of each UAV to its parent{suffix}; thin lines: desired, {DEADLINE_NOTE}"
    return Figure(name, f"Fig. {number}", caption, telling=number == 9)


def angles(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int, suffix: str
) -> Figure:
    """The two angles of (23)."""
    made = style.figure(140)
    sheet = {"time_s": times_column(flights["paper"].times)}
    titles = tuple(
        f"({letter}) {plane}, profile {profile}"
        for letter, (profile, plane) in zip(
            "abcd", [(p, plane) for p in _SHOWN for plane in ("XOY", "XOZ")], strict=True
        )
    )
    rows = panels(made, 4, titles, flights["paper"].scenario.duration_s, one_scale=False)
    for index, axes in enumerate(rows):
        profile, column = _SHOWN[index // 2], 1 + index % 2
        flown = flights[profile]
        value, desired = unwrapped(flown, column), desired_values(flown)[:, column]
        _curves(axes, flown, value, desired)
        axes[0].set_ylabel(("θ" if column == 1 else "φ") + " [rad]")
        for row, uav in enumerate(flown.scenario.uav_ids):
            if uav != flown.scenario.leader_id:
                plane = "theta" if column == 1 else "phi"
                sheet[f"{profile}_uav{uav}_{plane}_rad"] = value[:, row]
    style.legend(made, rows[0][0], columns=4)
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_angle"
    workshop.figure(name, made, sheet)
    caption = (
        f"Angles of each UAV in XOY and XOZ{suffix}; thin lines: desired, {DEADLINE_NOTE}. The XOZ angle of UAV 3 "
        "begins late: in Table 2 it shares x and z with its parent, and there is none"
    )
    return Figure(name, f"Fig. {number}", caption)


def unwrapped(flown: JudgedFlight, column: int) -> Array:
    """An angle (T, N) [rad] without jumps, ending within half a turn of the desired one.

    NaN where a UAV and its parent coincide in the plane: Table 2 starts UAV 2 and 3 so, and there is no angle.
    """
    value = np.unwrap(task_values(flown)[:, :, column], axis=0)
    turns = np.round((value[-1] - desired_values(flown)[:, column]) / (2 * np.pi))
    value -= 2 * np.pi * turns
    plane = (0, 1) if column == 1 else (0, 2)
    scenario, places = flown.scenario, flown.positions[:, :, plane]
    for row, uav in enumerate(scenario.uav_ids):
        parent = scenario.parent(uav)
        if parent is not None:
            arm = places[:, row] - places[:, scenario.uav_ids.index(parent)]
            value[np.linalg.norm(arm, axis=1) < _SHORTEST_ARM_M, row] = np.nan
    return np.asarray(value)


def yaw(flown: JudgedFlight, row: int) -> Array:
    """Yaw (T,) [rad] of one UAV."""
    x, y, z, w = flown.flight.track.odometry[:, row, 3:7].T
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def leader_yaw(
    workshop: ExperimentFolder, flights: Mapping[str, JudgedFlight], number: int, suffix: str
) -> Figure:
    """Yaw of the leader under every profile."""
    made = style.figure(52)
    sheet = {"time_s": times_column(flights["paper"].times)}
    axes = panels(made, 1, ("",), flights["paper"].scenario.duration_s)[0]
    for index, (profile, flown) in enumerate(flights.items()):
        row = flown.scenario.uav_ids.index(flown.scenario.leader_id)
        value = yaw(flown, row)
        _both(axes, flown.times, value, label=f"profile {profile}", **style.look(index))
        sheet[f"{profile}_yaw_rad"] = value
    axes[0].axvline(
        flights["paper"].scenario.gains.attitude.deadline_s, color="black", linewidth=0.6
    )
    axes[0].set_ylabel("yaw of the leader [rad]")
    style.legend(made, axes[0], columns=3)
    name = f"fig_{number:02d}_{flights['paper'].scenario.name}_yaw"
    workshop.figure(name, made, sheet)
    caption = f"Yaw of the leader{suffix}; upright line: deadline of the attitude loop"
    return Figure(name, f"Fig. {number}", caption)
