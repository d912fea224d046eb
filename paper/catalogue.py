"""The experiments by name. This module loads no laws, so that `--help` and a refusal are quick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError

if TYPE_CHECKING:
    from paper.experiment_result import ExperimentResult
    from paper.output import ExperimentFolder


@dataclass(frozen=True)
class Experiment:
    """One part of the reproduction; its code is the module of the same name in `experiments/`."""

    name: str
    scenarios: str  # what it flies
    seconds: float  # on one core with compiled laws: for the order and the progress bar
    alone: bool = False  # measures time: no other experiment may run beside it

    def load(self) -> Callable[[ExperimentFolder], ExperimentResult]:
        """The function that runs it."""
        run: Callable[[ExperimentFolder], ExperimentResult] = import_module(
            f"paper.experiments.{self.name}"
        ).run
        return run


EXPERIMENTS = (
    Experiment("promise", "paper_5, paper_5_free, experiment_4, by sweeps", 100),
    Experiment("promise_20", "paper_20, by sweeps", 190),
    Experiment("simulation_1", "paper_5, paper_5_free", 25),
    Experiment("baselines", "paper_5_free, paper_20", 80),
    Experiment("simulation_2", "paper_20", 25),
    Experiment("experiment", "experiment_4, by sweeps", 60),
    Experiment("estimator", "paper_5_free", 4),
    Experiment("ablations", "paper_5, paper_20, by sweeps", 100),
    Experiment("time_base", "paper_5_free, by sweeps", 80),
    Experiment("cost", "trees of 5 to 50 UAVs", 5, alone=True),
)


def select(names: list[str] | None) -> tuple[Experiment, ...]:
    """The experiments of these names in the order of the catalogue; all of them when no name is given."""
    known = [experiment.name for experiment in EXPERIMENTS]
    for name in names or ():
        if name not in known:
            raise PtnsbcError(f"--only {name}: expected one of {', '.join(known)}")
    return tuple(one for one in EXPERIMENTS if not names or one.name in names)
