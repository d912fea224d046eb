"""Ablations of the time base by sweeps: on and off in each loop, residual and deadline."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from paper.experiment_result import ExperimentResult
from paper.flights import PLANTS
from paper.output import ExperimentFolder
from paper.swept import RUNS, SweepCase, swept_table

LOOPS = {
    "formation": ("gains.formation.time_base", "gains.attitude.time_base"),
    "estimator": ("gains.estimator.time_base",),
    "controller": ("gains.force.time_base", "gains.torque.time_base"),
}
RESIDUALS = (0.2, 0.02, 0.001)
DEADLINES_S = (3.0, 4.0, 5.0, 7.0, 10.0)
_AFTER_S = 5.0


def _time_bases() -> Iterator[SweepCase]:
    for on in product((True, False), repeat=len(LOOPS)):
        switches = {
            key: state for keys, state in zip(LOOPS.values(), on, strict=True) for key in keys
        }
        labels = tuple("on" if state else "off" for state in on)
        yield SweepCase(labels, changes={"plant.kind": "rigid_body_6dof", **switches})


def _loops() -> Iterator[SweepCase]:
    given = [(q, 5.0) for q in RESIDUALS] + [(0.02, tf_s) for tf_s in DEADLINES_S if tf_s != 5.0]
    for plant, (q, tf_s) in product(PLANTS, given):
        changes = {
            "plant.kind": plant,
            "gains.formation.residual": q,
            "gains.formation.deadline_s": tf_s,
        }
        labels = (plant, f"{q:g}", f"{tf_s:g}")
        yield SweepCase(labels, changes=changes, stop_after_s=tf_s + _AFTER_S)


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep all of them."""
    return ExperimentResult(
        "time_base",
        "Ablations: the time base",
        f"{RUNS} flights for each row, 10 s each or until {_AFTER_S:g} s after the deadline, with starts drawn beside "
        "those of the file (0.3 m per axis). The paper's law with profile `soft`.",
        tables=(
            swept_table(
                output,
                "time base",
                "The time base in each loop: `paper_5_free` on `rigid_body_6dof`",
                tuple(LOOPS),
                _time_bases(),
                "Off means the constant gain Λκ from the start, without Ξ and without the soft onset.",
            ),
            swept_table(
                output,
                "residual and deadline",
                "Residual q and deadline tf: `paper_5_free`",
                ("plant", "q", "tf, s"),
                _loops(),
                "After tf only κ is left, and no q changes what follows.",
            ),
        ),
    )
