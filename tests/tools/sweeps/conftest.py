"""A sweep of twelve short flights, and tables that nobody flew."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import made_tables
import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.draws import parse_axis, parse_starts
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_sim.sweep.runner import run

AXES = ("plant.mass_kg=1.0,1.2", "gains.formation.kappa_1_s=1:3")


@pytest.fixture(scope="session")
def made() -> ModuleType:
    return made_tables


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep: two masses, six flights each."""
    quick = {"timing.duration_s": 1.2, "gains.formation.deadline_s": 0.8}
    axes = tuple(parse_axis(text) for text in AXES)
    starts = parse_starts("near:0.2")
    plan = plan_of(load_scenario("paper_5", quick), 6, axes=axes, starts=starts, name="small")
    return run(plan, tmp_path_factory.mktemp("sweeps") / "small", workers=1).folder
