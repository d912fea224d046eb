"""Ablation: twenty UAVs from random starts; which formation task finds the shape, and where the others end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.track import ERROR
from ptnsbc_sim.verdict.deadline import TOLERANCE_M
from ptnsbc_tools.reproduce.experiment_result import Cell, Column, ExperimentResult, Table
from ptnsbc_tools.reproduce.flights import PLANTS, TASKS, JudgedFlight, judge, scenario
from ptnsbc_tools.reproduce.output import ExperimentFolder

DRAWS = 6
HALF_BOX_M, APART_M = 6.0, 1.0
SECONDS = 10.0


def starts(seed: int, count: int, height_m: float) -> Array:
    """Positions (count, 3) [m], uniform in the box, `APART_M` apart or more: a position too close is drawn again."""
    numbers = np.random.default_rng(seed)
    found: list[Array] = []
    while len(found) < count:
        place = np.array([*numbers.uniform(-HALF_BOX_M, HALF_BOX_M, 2), height_m])
        if all(np.linalg.norm(place - other) >= APART_M for other in found):
            found.append(place)
    return np.stack(found)


def _flight(plant: str, task: str, seed: int | None) -> JudgedFlight:
    """`paper_20` without obstacles from random starts, or from the starts of the file."""
    changes: dict[str, Any] = {
        "plant.kind": plant,
        "formation.task": task,
        "timing.duration_s": SECONDS,
        "world.obstacles": [],
    }
    if seed is not None:
        uavs = scenario("paper_20").file.uavs
        for row, place in enumerate(starts(seed, len(uavs), uavs[0].position_m[2])):
            changes[f"uavs[{row}].position_m"] = place.round(3).tolist()
    return judge(fly(scenario("paper_20", changes)))


def _elsewhere(one: JudgedFlight) -> int:
    """How many followers end in a wrong place with their task fulfilled: another shape has the same sigma."""
    scales = np.stack([np.array(agent_config(one.scenario, uav).row_scale) for uav in one.uavs])
    task = np.abs(one.flight.track.diagnostics[-1, :, ERROR]) * scales
    wrong = one.errors()[-1] > 4.0 * TOLERANCE_M
    return int(np.sum(wrong & (task.max(axis=1) <= 2.0 * TOLERANCE_M)))


def _in_place(one: JudgedFlight) -> int:
    """How many UAVs are in their place at the end, however late."""
    return int(np.sum(one.errors()[-1] <= TOLERANCE_M))


def _row(output: ExperimentFolder, plant: str, task: str) -> tuple[Cell, ...]:
    output.progress(f"flying {plant}, {task}")
    found = [_flight(plant, task, seed) for seed in range(DRAWS)]
    return (
        plant,
        task,
        _flight(plant, task, None).met_text(),
        f"{sum(one.all_met() for one in found)} of {DRAWS}",
        float(np.mean([one.met() for one in found])),
        float(np.mean([_in_place(one) for one in found])),
        float(np.mean([_elsewhere(one) for one in found])),
        float(np.mean([uav.saturated_s for one in found for uav in one.verdict.uavs])),
    )


def _extreme(
    rows: Sequence[tuple[Cell, ...]],
    column: int,
    of: Callable[[list[float]], float],
    task: str | None = None,
) -> float:
    return of([float(row[column] or 0.0) for row in rows if task in (None, row[1])])


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly every task from every draw of starts."""
    rows = tuple(_row(output, plant, task) for plant in PLANTS for task in TASKS)
    ranges = [
        f"`{task}` {_extreme(rows, 5, min, task):.1f} to {_extreme(rows, 5, max, task):.1f}"
        for task in TASKS
    ]
    table = Table(
        "ablation_starts",
        "From starts that have nothing to do with the shape",
        (
            Column("plant"),
            Column("task"),
            Column("met, starts of the file"),
            Column("draws in which all met"),
            Column("UAVs that met, mean", 1),
            Column("in place at the end, mean", 1),
            Column("task fulfilled elsewhere, mean", 1),
            Column("saturated until tf, s, mean", 2),
        ),
        rows,
        f"In their place after {SECONDS:g} s are, of twenty: {'; '.join(ranges)}. From such starts UAVs are at the "
        f"limit of speed or acceleration for up to {_extreme(rows, 7, max):.1f} s before the deadline, which voids the "
        "promise for every task, and cross each other's ways. The paper prints no starts; those of `paper_20` are near "
        "the shape, as an operator would set the UAVs out.",
    )
    return ExperimentResult(
        "ablation_starts",
        "Ablation: starts of the twenty",
        f"Scenario `paper_20` without its obstacles, profile `soft`, {SECONDS:g} s, from its own starts and from "
        f"{DRAWS} draws: uniform in a box of {2 * HALF_BOX_M:g} m x {2 * HALF_BOX_M:g} m, {APART_M:g} m apart or more, "
        "and nobody near the place that it is to take.",
        tables=(table,),
    )
