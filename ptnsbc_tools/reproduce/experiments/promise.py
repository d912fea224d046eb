"""The promise in every scenario, from starts beside those of the file: our approach, and the paper's law."""

from __future__ import annotations

from collections.abc import Mapping

from ptnsbc_tools.reproduce.claims import experiment_claim, formation_claim
from ptnsbc_tools.reproduce.experiment_result import Claim, ExperimentResult
from ptnsbc_tools.reproduce.flights import PLANTS
from ptnsbc_tools.reproduce.output import ExperimentFolder
from ptnsbc_tools.reproduce.swept import (
    DEFAULT_APPROACH,
    RUNS,
    SweepCase,
    fly_case,
    met,
    shares_table,
)
from ptnsbc_tools.sweeps.share import Share
from ptnsbc_tools.sweeps.table import FlightTable

_QUADROTOR = ("quadrotor",)
SCENARIOS = {
    "paper_5_free": PLANTS,
    "paper_5": PLANTS,
    "paper_20": PLANTS,
    "experiment_4_calm": _QUADROTOR,
    "experiment_4": _QUADROTOR,
}
PRINTED = "paper"
LAWS = {
    "ours": DEFAULT_APPROACH,
    "soft": {"gains.profile": "soft"},
    PRINTED: {"gains.profile": "paper"},
}
_HEADS = ("scenario", "plant", "law")


def _case(scenario: str, plant: str, law: str) -> SweepCase:
    return SweepCase((scenario, plant, law), scenario, {"plant.kind": plant, **LAWS[law]})


def _claims(flown: Mapping[tuple[str, str, str], FlightTable]) -> tuple[Claim, ...]:
    def by_law(scenario: str, plant: str) -> dict[str, Share]:
        return {law: met(flown[scenario, plant, law]) for law in LAWS}

    body, quadrotor = PLANTS
    return (
        *(
            formation_claim(scenario, by_law(scenario, body))
            for scenario in ("paper_5", "paper_5_free", "paper_20")
        ),
        experiment_claim(by_law("experiment_4", quadrotor)),
    )


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep every scenario with every law."""
    flown = {
        (name, plant, law): fly_case(output, "promise", _case(name, plant, law)).table
        for name, plants in SCENARIOS.items()
        for plant in plants
        for law in LAWS
    }
    table = shares_table(
        "promise",
        "The promise in every scenario",
        _HEADS,
        flown.items(),
        "A flight is met when every UAV is within the tolerance of its place at the deadline, stays within that or "
        "2 % of its start error, and nobody enters a keep-out. An error in an encounter is excused; the column beside "
        "it has the error without excuse (`docs/verdict.md`).",
    )
    return ExperimentResult(
        "promise",
        "Every scenario",
        f"{RUNS} flights of 10 s for each row, with starts drawn beside those of the file (0.3 m per axis) and a "
        "seed of its own for noise, losses and gusts. Law `ours` is the planned approach with profile `soft`, the "
        "default; `soft` is the paper's law with that profile; `paper` is the paper's law with the printed gains. "
        "Wilson intervals at 95 %.",
        tables=(table,),
        claims=_claims(flown),
    )
