"""The experiment: four quadrotors in wind, with the noise and the links of the field. Figs. 33 and 34."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_tools.reproduce.claims import experiment_claim
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, Figure
from ptnsbc_tools.reproduce.experiments.experiment_causes import causes_table, draws_table, told
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.figures.paths import (
    columns,
    draw_from_above,
    in_space,
    links,
    shape_note,
)
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown

_DRIFT = "they start tilted by 1 rad, as printed, and drift 0.6 m until they are level"
SNAPSHOTS_S = (0.0, 2.0, 23.0, 50.0)
SEEDS = tuple(range(1, 25))  # its gains were searched on these
FRESH = tuple(range(101, 117))  # and on none of these


def flight(seed: int) -> JudgedFlight:
    """The experiment with one draw of its noise, losses and gusts."""
    return flown("experiment_4", {"seed": seed})


def _paths(workshop: ExperimentFolder, one: JudgedFlight) -> Figure:
    made = style.figure(100)
    axes = made.add_subplot()
    draw_from_above(axes, one)
    style.legend(made, axes, columns=4)
    name = "fig_33_experiment_4_xy"
    workshop.figure(name, made, columns(one))
    return Figure(
        name,
        "Fig. 33",
        f"Trajectories of four quadrotors in wind, from above; {_DRIFT}; {shape_note()}",
        telling=True,
    )


def _instants(one: JudgedFlight) -> list[int]:
    """Ticks of the snapshots; the last one when the flight ends with it."""
    return [int(np.argmin(np.abs(one.times - seconds))) for seconds in SNAPSHOTS_S]


def _snapshot(axes: Any, one: JudgedFlight, tick: int) -> None:
    """Where everybody is, who follows whom, and the desired places."""
    scenario, places = one.scenario, one.positions[tick]
    leader = places[scenario.uav_ids.index(scenario.leader_id)]
    links(axes, one, tick)
    for row, uav in enumerate(scenario.uav_ids):
        wanted = leader + scenario.offset(uav)
        axes.plot(*wanted[:2], marker="+", color="black", markersize=13, zorder=2)
        axes.plot(
            *places[row, :2], marker="o", color=style.look(row)["color"], markersize=8, zorder=3
        )
        axes.annotate(
            str(uav), places[row, :2], color="white", fontsize=6.5, fontweight="bold",
            ha="center", va="center_baseline", zorder=4,
        )  # fmt: skip
    centre = places[:, :2].mean(axis=0)
    axes.set(xlim=(centre[0] - 2.0, centre[0] + 2.0), ylim=(centre[1] - 1.7, centre[1] + 1.7))
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        style.round_ticks(axis, 4)


def _snapshots(workshop: ExperimentFolder, one: JudgedFlight) -> Figure:
    made = style.figure(88)
    grid = made.subplots(2, 2)
    ticks = _instants(one)
    for axes, letter, seconds, tick in zip(grid.flat, "abcd", SNAPSHOTS_S, ticks, strict=True):
        _snapshot(axes, one, tick)
        axes.set_title(
            f"({letter}) {seconds:g} s, z = {one.positions[tick, 0, 2]:.1f} m", loc="left"
        )
    made.supxlabel("x (east) [m]", fontsize=8)
    made.supylabel("y (north) [m]", fontsize=8)
    name = "fig_34_experiment_4_snapshots"
    sheet = {key: column[ticks] for key, column in columns(one).items()}
    workshop.figure(name, made, sheet)
    caption = (
        "The formation at four instants from above, z of the leader; numbers: the UAVs, crosses: places that they are "
        "to have beside the leader, lines: who follows whom"
    )
    return Figure(name, "Fig. 34", caption)


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly, draw and judge the experiment."""
    flights = [flight(seed) for seed in told(workshop, SEEDS)]
    fresh = [flight(seed) for seed in told(workshop, FRESH)]
    first, calm = flights[0], flown("experiment_4_calm")
    return ExperimentResult(
        "experiment",
        "The experiment: four quadrotors",
        "Scenario `experiment_4`, 50 s, on the quadrotor plant: position noise and rate of an RTK receiver, latency, "
        "lost messages, wind with gusts, noise of the sensor that sees the others. What is not printed is chosen, and "
        f"said in the scenario file. Its gains were searched on seeds {SEEDS[0]} to {SEEDS[-1]}; seeds {FRESH[0]} to "
        f"{FRESH[-1]} were flown with them afterwards, and nothing was changed for these.",
        figures=(
            in_space(workshop, first, 33, f" of four quadrotors in wind; {_DRIFT}"),
            _paths(workshop, first),
            _snapshots(workshop, first),
        ),
        tables=(
            draws_table(flights, "the draws on which its gains were chosen"),
            draws_table(fresh, "draws that no gain was chosen on"),
            causes_table(workshop),
        ),
        claims=(experiment_claim(flights, fresh, calm),),
    )
