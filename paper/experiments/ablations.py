"""Ablations by sweeps: profile and task, avoidance rule, starts, adaptation."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

from paper.experiment_result import ExperimentResult
from paper.flights import PROFILES, Setting
from paper.output import ExperimentFolder
from paper.swept import DEFAULT_APPROACH, RUNS, SweepCase, swept_table
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_sim.sweep.family import find_family

RULES = ("off", "set_based", "switched")
APPROACHES: dict[str, Setting] = {"ours": DEFAULT_APPROACH, "soft": {}}
_BOX = "box:12,12,1"
_ADAPTATION: dict[str, dict[str, Any]] = {
    "on": {},
    "parameters fixed": {"gains.adaptation.gamma_mass": 1e9, "gains.adaptation.gamma_inertia": 1e9},
    "bound fixed at 0": {"gains.adaptation.upsilon": 1e9},
    "observer off": {"gains.observer.bandwidth_1_s": 0.0},
}


def _laws() -> Iterator[SweepCase]:
    for profile, task in product(PROFILES, TASKS):
        changes = {
            "gains.profile": profile, "formation.task": task, "formation.avoidance": "set_based",
            "plant.kind": "quadrotor",
        }  # fmt: skip
        yield SweepCase((profile, task, "set_based"), "paper_5", changes)


def _rules() -> Iterator[SweepCase]:
    family = find_family("clutter").read_text(encoding="utf-8")
    for (law, changes), rule in product(APPROACHES.items(), RULES):
        yield SweepCase(
            (law, rule),
            changes={**changes, "formation.avoidance": rule},
            starts="file",
            family=family,
            stop_after_s=None,
        )


def _starts() -> Iterator[SweepCase]:
    for task in ("planned approach", *TASKS):
        own = {"formation.task": task} if task in TASKS else DEFAULT_APPROACH
        changes = {"plant.kind": "quadrotor", "world.obstacles": [], **own}
        yield SweepCase((task,), "paper_20", changes, starts=_BOX)


def _adaptations() -> Iterator[SweepCase]:
    for name, changes in _ADAPTATION.items():
        family = find_family("mass").read_text(encoding="utf-8")
        changes = {**changes, **DEFAULT_APPROACH}
        yield SweepCase((name,), changes=changes, starts="file", family=family, stop_after_s=None)


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep all of them."""
    return ExperimentResult(
        "ablations",
        "Ablations",
        f"{RUNS} flights for each row, 10 s each, with starts drawn beside those of "
        "the file (0.3 m per axis). The paper's law with profile `soft`, but where a table says otherwise.",
        tables=(
            swept_table(
                output,
                "laws",
                "Profile and task: `paper_5` on `quadrotor`, the 10 s before its obstacles",
                ("profile", "task", "avoidance"),
                _laws(),
            ),
            swept_table(
                output,
                "rules",
                "Avoidance rule: family `clutter`, up to eight obstacles on the way",
                ("law", "avoidance"),
                _rules(),
                "`switched` is the printed rule (38), which asks for nothing until a UAV is inside; `set_based` limits "
                "the speed of the approach. `off` shows what happens without either. Laws as in *Every scenario*.",
            ),
            swept_table(
                output,
                "starts",
                "Twenty UAVs from anywhere in a box of 12 m: `paper_20` on `quadrotor`, without obstacles",
                ("law",),
                _starts(),
                "Starts that have nothing to do with the shape. The paper prints no starts; those of `paper_20` are "
                "near the shape, as an operator would set the UAVs out.",
            ),
            swept_table(
                output,
                "adaptation",
                "What adapts, with wrong masses in wind: family `mass`, planned approach",
                ("adaptation",),
                _adaptations(),
                "True mass and inertia differ from what the laws know by up to 30 %, in wind of 8 m/s with "
                "gusts. The observer, the parameters (50) and the bound (51), one switched off at a time.",
            ),
        ),
    )
