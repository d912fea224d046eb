"""Ours, taken apart: gain profile x formation task x avoidance rule, on both plants."""

from __future__ import annotations

from itertools import product

import numpy as np

from ptnsbc_sim.swarm import ACTIVE_ROWS
from ptnsbc_tools.reproduce.claims import kept
from ptnsbc_tools.reproduce.flights import Flown, flown
from ptnsbc_tools.reproduce.part import Cell, Column, Part, Table
from ptnsbc_tools.reproduce.workshop import Workshop

PLANTS = ("rigid_body_6dof", "quadrotor")
PROFILES = ("paper", "soft", "reference")
TASKS = ("distance_angles", "parent_angle", "relative_position")
RULES = ("off", "set_based", "switched")


def run(workshop: Workshop) -> Part:
    """Fly every combination."""
    return Part(
        "ablation_profiles",
        "Ablation: gain profile, formation task, avoidance rule",
        "Scenario `paper_5`, 60 s, every combination. *Room* is the smallest distance to any UAV or obstacle less "
        "its keep-out: negative is inside. *Switches*: how often avoidance began or ended, all UAVs together.",
        tables=tuple(_table(workshop, plant) for plant in PLANTS),
    )


def _flight(plant: str, profile: str, task: str, rule: str) -> Flown:
    return flown(
        "paper_5",
        {
            "plant.kind": plant,
            "gains.profile": profile,
            "formation.task": task,
            "formation.avoidance": rule,
        },
    )


def switches(one: Flown) -> int:
    """How often a UAV began or stopped to give way."""
    active = one.flight.track.diagnostics[:, :, ACTIVE_ROWS] > 0
    return int(np.abs(np.diff(active.astype(np.int64), axis=0)).sum())


def _table(workshop: Workshop, plant: str) -> Table:
    rows: list[tuple[Cell, ...]] = []
    good: list[str] = []
    for profile, task in product(PROFILES, TASKS):
        workshop.tell(f"flying {plant}, {profile}, {task}")
        by_rule = {rule: _flight(plant, profile, task, rule) for rule in RULES}
        ours = by_rule["set_based"]
        rows.append(
            (
                profile,
                task,
                *(f"{one.met()} of {len(one.verdict.uavs)}" for one in by_rule.values()),
                ours.worst_at_deadline_m(),
                *(one.clearance_m() for one in by_rule.values()),
                switches(by_rule["set_based"]),
                switches(by_rule["switched"]),
            )
        )
        good += [f"`{profile}` × `{task}`"] if kept(ours) else []
    columns = (
        Column("profile"),
        Column("task"),
        *(Column(f"met, {rule}") for rule in RULES),
        Column("error at 5 s, m", 4),
        *(Column(f"room, {rule}, m", 3) for rule in RULES),
        Column("switches, set_based"),
        Column("switches, switched"),
    )
    told = ", ".join(good) if good else "none"
    return Table(
        f"ablation_profiles_{plant}",
        f"On `{plant}`",
        columns,
        tuple(rows),
        f"Deadline met by all UAVs and nothing touched, with the rule `set_based`: {told}. The smallest room is "
        f"{_least(rows, 6):.2f} m without avoidance, {_least(rows, 7):.3f} m with `set_based` and "
        f"{_least(rows, 8):.3f} m with the printed rule `switched`, which asks for nothing until a UAV is inside (38 "
        "there, 37 outside): how far it goes in is how long the vehicle takes to turn. It is kept for comparison.",
    )


def _least(rows: list[tuple[Cell, ...]], column: int) -> float:
    return min(float(row[column] or 0.0) for row in rows)
