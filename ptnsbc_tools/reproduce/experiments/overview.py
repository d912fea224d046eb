"""Every scenario of the paper at a glance: our flight profile and the printed gains."""

from __future__ import annotations

from ptnsbc_tools.reproduce.columns import verdicts_table
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult
from ptnsbc_tools.reproduce.flights import PLANTS, JudgedFlight, fly_judged
from ptnsbc_tools.reproduce.output import ExperimentFolder

SCENARIOS = {
    "paper_5_free": PLANTS,
    "paper_5": PLANTS,
    "paper_20": PLANTS,
    "experiment_4_calm": ("quadrotor",),
    "experiment_4": ("quadrotor",),
}
OURS, PRINTED = "soft", "paper"


def fly_all(profile: str, output: ExperimentFolder) -> list[JudgedFlight]:
    """Every scenario on its plants."""
    found = []
    for scenario, plants in SCENARIOS.items():
        for plant in plants:
            output.progress(f"flying {scenario}, {plant}, {profile}")
            found.append(fly_judged(scenario, {"plant.kind": plant, "gains.profile": profile}))
    return found


def _count(flights: list[JudgedFlight]) -> str:
    return f"{sum(one.kept_promise() for one in flights)} of {len(flights)} flights"


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly every scenario with both profiles."""
    ours, printed = fly_all(OURS, output), fly_all(PRINTED, output)
    table = verdicts_table(
        "overview",
        "The promise in every scenario, the worst UAV of each",
        [*ours, *printed],
        f"Kept by all UAVs: with our flight profile `{OURS}` in {_count(ours)}; with the printed gains, profile "
        f"`{PRINTED}`, in {_count(printed)}.",
    )
    return ExperimentResult(
        "overview",
        "Every scenario",
        "The promise: at 5 s every UAV within the tolerance of its place, from then on within that or 2 % of its "
        "start error, and nothing touched. The tolerance is 0.05 m. An error near objects is excused for as "
        "long as the table says, and stands beside the one without excuse (`docs/verdict.md`).",
        tables=(table,),
    )
