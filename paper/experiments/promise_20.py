"""The promise with twenty UAVs: as part `promise`, apart because it takes as long as all others."""

from __future__ import annotations

from paper.claims import formation_claim
from paper.experiment_result import ExperimentResult
from paper.experiments.promise import MEANING, swept_laws
from paper.flights import PLANTS
from paper.output import ExperimentFolder


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep the twenty with every law."""
    table, shares = swept_laws(output, {"paper_20": PLANTS}, "The promise with twenty UAVs")
    return ExperimentResult(
        "promise_20",
        "Twenty UAVs",
        MEANING,
        tables=(table,),
        claims=(formation_claim("paper_20", shares["paper_20", PLANTS[0]]),),
    )
