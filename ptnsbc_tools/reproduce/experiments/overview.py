"""Every scenario of the paper at a glance: our flight profile and the printed gains."""

from __future__ import annotations

from ptnsbc_tools.reproduce.claims import kept
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown
from ptnsbc_tools.reproduce.summary import flights_table

SCENARIOS = {
    "paper_5_free": ("rigid_body_6dof", "quadrotor"),
    "paper_5": ("rigid_body_6dof", "quadrotor"),
    "paper_20": ("rigid_body_6dof", "quadrotor"),
    "experiment_4_calm": ("quadrotor",),
    "experiment_4": ("quadrotor",),
}
OURS, PRINTED = "soft", "paper"


def flights(profile: str, workshop: ExperimentFolder) -> list[JudgedFlight]:
    """Every scenario on its plants."""
    found = []
    for scenario, plants in SCENARIOS.items():
        for plant in plants:
            workshop.tell(f"flying {scenario}, {plant}, {profile}")
            found.append(flown(scenario, {"plant.kind": plant, "gains.profile": profile}))
    return found


def _told(some: list[JudgedFlight]) -> str:
    return f"{sum(kept(one) for one in some)} of {len(some)} flights"


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly all of them twice."""
    ours, printed = flights(OURS, workshop), flights(PRINTED, workshop)
    return ExperimentResult(
        "overview",
        "Every scenario",
        "The promise: at 5 s every UAV within the tolerance of its place, from then on within that or 2 % of its "
        "start error, and nothing touched. The tolerance is 0.05 m. A missed deadline is `void` where actuators were "
        "at their limit or a UAV gave way (`docs/verdict.md`).",
        tables=(
            flights_table(
                "overview",
                "The promise in every scenario, the worst UAV of each",
                [*ours, *printed],
                f"Kept by all UAVs: with our flight profile `{OURS}` in {_told(ours)}; with the printed gains, profile "
                f"`{PRINTED}`, in {_told(printed)}.",
            ),
        ),
    )
