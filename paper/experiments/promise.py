"""The promise in every scenario, from starts beside those of the file: our approach, and the paper's law."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from paper import flights
from paper.claims import experiment_claim, formation_claim
from paper.experiment_result import ExperimentResult, Table
from paper.flights import PLANTS
from paper.output import ExperimentFolder
from paper.swept import (
    DEFAULT_APPROACH,
    RUNS,
    SweepCase,
    fly_case,
    met,
    shares_table,
)
from ptnsbc_sim.verdict.deadline import TOLERANCE_M
from ptnsbc_tools.sweeps.summary import Share

_QUADROTOR = ("quadrotor",)
SCENARIOS = {
    "paper_5_free": PLANTS,
    "paper_5": PLANTS,
    "experiment_4_calm": _QUADROTOR,
    "experiment_4": _QUADROTOR,
}
PAST_AN_OBSTACLE_S = 30.0
"""The leader of `paper_5` and `paper_20` passes the first obstacle between 15 and 28 s."""

PRINTED = "paper"
LAWS = {
    "ours": DEFAULT_APPROACH,
    "soft": {"gains.profile": "soft"},
    PRINTED: {"gains.profile": "paper"},
}


def law_case(scenario: str, plant: str, law: str) -> SweepCase:
    """The sweep of one row: 10 s, or past an obstacle where the scenario has some."""
    changes = {"plant.kind": plant, **LAWS[law]}
    stop_s = PAST_AN_OBSTACLE_S if scenario in ("paper_5", "paper_20") else 10.0
    return SweepCase((scenario, plant, law), scenario, changes, stop_after_s=stop_s)


def swept_laws(
    output: ExperimentFolder, scenarios: Mapping[str, Sequence[str]], title: str
) -> tuple[Table, dict[tuple[str, str], dict[str, Share]]]:
    """Sweep scenarios with every law: the table, and the share of each law by scenario and plant."""
    flown = {
        (name, plant, law): fly_case(output, "promise", law_case(name, plant, law)).table
        for name, plants in scenarios.items()
        for plant in plants
        for law in LAWS
    }
    shares = {
        (name, plant): {law: met(flown[name, plant, law]) for law in LAWS}
        for name, plants in scenarios.items()
        for plant in plants
    }
    table = shares_table(
        f"promise {'-'.join(scenarios)}",
        title,
        ("scenario", "plant", "law"),
        flown.items(),
        "A flight is met when every UAV is within the tolerance of its place at the deadline "
        f"({_tolerances(scenarios)}), stays within that or "
        "2 % of its start error, and nobody enters a keep-out. An error in an encounter is excused; the column beside "
        "it has the error without excuse (`docs/verdict.md`).",
    )
    return table, shares


def _tolerances(names: Iterable[str]) -> str:
    """The tolerances of scenarios in words."""
    own = {name: flights.scenario(name).formation.tolerance_m for name in names}
    others = [f"{metres:g} m in `{name}`" for name, metres in own.items() if metres != TOLERANCE_M]
    return ", ".join([f"{TOLERANCE_M:g} m", *others])


MEANING = (
    f"{RUNS} flights for each row, with starts drawn beside those of the file (0.3 m per axis) and a seed of its own "
    f"for noise, losses and gusts: 10 s, and {PAST_AN_OBSTACLE_S:g} s where there are obstacles, past the first one. "
    "Law `ours` is the planned approach with profile `soft`, the default; `soft` is the paper's law with that "
    "profile; `paper` is the paper's law with the printed gains. Wilson intervals at 95 %."
)


def run(output: ExperimentFolder) -> ExperimentResult:
    """Sweep every scenario of five or four UAVs with every law."""
    table, shares = swept_laws(output, SCENARIOS, "The promise with four and five UAVs")
    body, quadrotor = PLANTS
    return ExperimentResult(
        "promise",
        "Every scenario",
        MEANING,
        tables=(table,),
        claims=(
            formation_claim("paper_5", shares["paper_5", body]),
            formation_claim("paper_5_free", shares["paper_5_free", body]),
            experiment_claim(shares["experiment_4", quadrotor]),
        ),
    )
