"""The experiments by name. Loads nothing: `--help` and a refusal need no laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError

if TYPE_CHECKING:
    from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
    from ptnsbc_tools.reproduce.experiment_result import ExperimentResult


@dataclass(frozen=True)
class Experiment:
    """One part of the reproduction, in the module of its name beside this one."""

    name: str
    needs: str  # what it flies
    seconds: float  # on one core, laws compiled: for the order and the progress bar
    alone: bool = False  # measured by the clock: nothing else may run

    def load(self) -> Callable[[ExperimentFolder], ExperimentResult]:
        """The function that runs it."""
        run: Callable[[ExperimentFolder], ExperimentResult] = import_module(
            f"ptnsbc_tools.reproduce.experiments.{self.name}"
        ).run
        return run


EXPERIMENTS = (
    Experiment("overview", "all scenarios", 25),
    Experiment("simulation_1", "paper_5, paper_5_free", 40),
    Experiment("baselines", "paper_5_free, paper_20", 100),
    Experiment("simulation_2", "paper_20", 35),
    Experiment("experiment", "experiment_4", 85),
    Experiment("ablation_profiles", "paper_5, both plants", 50),
    Experiment("ablation_starts", "paper_20, both plants", 40),
    Experiment("ablation_estimator", "paper_5_free", 4),
    Experiment("ablation_time_base", "paper_5_free", 8),
    Experiment("ablation_sweeps", "paper_5_free", 8),
    Experiment("cost", "trees of 5 to 50 UAVs", 5, alone=True),
)


def chosen(names: list[str] | None) -> tuple[Experiment, ...]:
    """The experiments of these names, in the order of the catalogue; all of them for none."""
    known = [one.name for one in EXPERIMENTS]
    for name in names or ():
        if name not in known:
            raise PtnsbcError(f"--only {name}: expected one of {', '.join(known)}")
    return tuple(one for one in EXPERIMENTS if not names or one.name in names)
