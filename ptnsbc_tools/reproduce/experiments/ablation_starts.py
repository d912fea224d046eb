"""Twenty UAVs from anywhere: which formation task finds the shape, and where those end that do not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import agent_config
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.track import ERROR
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import Cell, Column, ExperimentResult, Table
from ptnsbc_tools.reproduce.experiments.ablation_profiles import PLANTS, TASKS
from ptnsbc_tools.reproduce.flights import JudgedFlight, judged, scenario
from ptnsbc_tools.verdict.tolerances import TOLERANCE_M

DRAWS = 6
HALF_BOX_M, APART_M = 6.0, 1.0
SECONDS = 10.0


def starts(draw: int, count: int, height_m: float) -> Array:
    """Places (count, 3) [m], uniform in the box, as far apart as asked: those too close are drawn again."""
    numbers = np.random.default_rng(draw)
    found: list[Array] = []
    while len(found) < count:
        place = np.array([*numbers.uniform(-HALF_BOX_M, HALF_BOX_M, 2), height_m])
        if all(np.linalg.norm(place - other) >= APART_M for other in found):
            found.append(place)
    return np.stack(found)


def flight(plant: str, task: str, draw: int | None) -> JudgedFlight:
    """`paper_20` without obstacles from one draw, or from the starts of the file."""
    changes: dict[str, Any] = {
        "plant.kind": plant,
        "formation.task": task,
        "timing.duration_s": SECONDS,
        "world.obstacles": [],
    }
    if draw is not None:
        uavs = scenario("paper_20").file.uavs
        for row, place in enumerate(starts(draw, len(uavs), uavs[0].position_m[2])):
            changes[f"uavs[{row}].position_m"] = place.round(3).tolist()
    return judged(fly(scenario("paper_20", changes)))


def elsewhere(one: JudgedFlight) -> int:
    """How many followers end with their task fulfilled in a wrong place: another shape with the same sigma."""
    scales = np.stack([_row_scale(one, uav) for uav in one.scenario.uav_ids])
    task = np.abs(one.flight.track.diagnostics[-1, :, ERROR]) * scales
    wrong = one.errors()[-1] > 4.0 * TOLERANCE_M
    return int(np.sum(wrong & (task.max(axis=1) <= 2.0 * TOLERANCE_M)))


def _row_scale(one: JudgedFlight, uav: int) -> Array:
    return np.array(agent_config(one.scenario, uav).row_scale)


def _row(workshop: ExperimentFolder, plant: str, task: str) -> tuple[Cell, ...]:
    workshop.tell(f"flying {plant}, {task}")
    found = [flight(plant, task, draw) for draw in range(DRAWS)]
    count = len(found[0].verdict.uavs)
    whole = [one.met() == count for one in found]
    return (
        plant,
        task,
        f"{flight(plant, task, None).met()} of {count}",
        f"{sum(whole)} of {DRAWS}",
        float(np.mean([one.met() for one in found])),
        float(np.mean([_there(one) for one in found])),
        float(np.mean([elsewhere(one) for one in found])),
        _saturated_share(found),
    )


def _there(one: JudgedFlight) -> int:
    """How many are in their place at the end, however late."""
    return int(np.sum(one.errors()[-1] <= TOLERANCE_M))


def _saturated_share(found: Sequence[JudgedFlight]) -> float:
    return float(np.mean([uav.saturated_s for one in found for uav in one.verdict.uavs]))


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly every task from every draw."""
    rows = tuple(_row(workshop, plant, task) for plant in PLANTS for task in TASKS)
    return ExperimentResult(
        "ablation_starts",
        "Ablation: starts of the twenty",
        f"Scenario `paper_20` without its obstacles, profile `soft`, {SECONDS:g} s, from its own starts and from "
        f"{DRAWS} draws: uniform in a box of {2 * HALF_BOX_M:g} m x {2 * HALF_BOX_M:g} m, {APART_M:g} m apart or more, "
        "and nobody near the place that it is to take.",
        tables=(
            Table(
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
                _meaning(rows),
            ),
        ),
    )


def _meaning(rows: Sequence[tuple[Cell, ...]]) -> str:
    told = [
        f"`{task}` {_worst(rows, task, 5, min):.1f} to {_worst(rows, task, 5, max):.1f}"
        for task in TASKS
    ]
    return (
        f"In their place after {SECONDS:g} s are, of twenty: {'; '.join(told)}. From such starts UAVs are at the limit "
        f"of speed or acceleration for up to {_worst(rows, None, 7, max):.1f} s before the deadline, which voids the "
        "promise for every task, and cross each other's ways. The paper prints no starts; those of `paper_20` are near "
        "the shape, as an operator would set the UAVs out."
    )


def _worst(
    rows: Sequence[tuple[Cell, ...]],
    task: str | None,
    column: int,
    of: Callable[[list[float]], float],
) -> float:
    return of([float(row[column] or 0.0) for row in rows if task in (None, row[1])])
