"""Simulation 1: five UAVs on the six-input plant, with and without obstacles. Figs. 5-18 and 23."""

from __future__ import annotations

from ptnsbc_tools.reproduce.claims import formation_claim, kept, velocity_claim
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, Figure, Table
from ptnsbc_tools.reproduce.figures import energy, inputs, paths, shape
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown
from ptnsbc_tools.reproduce.summary import flights_table

PROFILES = ("paper", "soft", "reference")
PLANTS = ("rigid_body_6dof", "quadrotor")
SCENARIOS = {"paper_5": "", "paper_5_free": ", without obstacles"}


def flight(scenario: str, profile: str, plant: str = "rigid_body_6dof") -> JudgedFlight:
    """One of the flights of Simulation 1."""
    return flown(scenario, {"plant.kind": plant, "gains.profile": profile})


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly, draw and judge Simulation 1."""
    figures: list[Figure] = []
    for first, (scenario, suffix) in enumerate(SCENARIOS.items()):
        workshop.tell(f"flying {scenario}")
        by_profile = {profile: flight(scenario, profile) for profile in PROFILES}
        workshop.tell(f"drawing {scenario}")
        figures += [
            paths.in_space(workshop, by_profile["paper"], 5 + 2 * first, suffix),
            paths.from_above(workshop, by_profile["paper"], 6 + 2 * first, suffix),
            shape.distances(workshop, by_profile, 9 + first, suffix),
            shape.angles(workshop, by_profile, 11 + first, suffix),
            shape.leader_yaw(workshop, by_profile, 13 + first, suffix),
            inputs.whole(workshop, by_profile, 15 + first, suffix),
            inputs.first_second(workshop, by_profile, 17 + first, suffix),
        ]
    figures.append(energy.energy(workshop, {p: flight("paper_5", p) for p in ("paper", "soft")}))
    workshop.tell("flying the quadrotor")
    return ExperimentResult(
        name="simulation_1",
        title="Simulation 1: five UAVs",
        text=(
            "Scenario `paper_5` for 60 s, and `paper_5_free`, the same without its two obstacles. The "
            "figures show the paper's plant, a rigid body with six inputs, under the printed gains "
            "(profile `paper`: Λ = κ = 1); `soft`, our default for flight, and `reference` stand beside it. All "
            "are flown behind the command filter, which the paper does not have: part *Baselines* shows what it does."
        ),
        figures=tuple(sorted(figures, key=lambda one: one.name)),
        tables=(_verdicts(),),
        claims=(
            *(
                formation_claim(scenario, {p: flight(scenario, p) for p in PROFILES})
                for scenario in SCENARIOS
            ),
            velocity_claim({p: flight("paper_5_free", p) for p in PROFILES}),
        ),
    )


def _verdicts() -> Table:
    flights = [
        flight(scenario, profile, plant)
        for scenario in SCENARIOS
        for plant in PLANTS
        for profile in PROFILES
    ]
    good = [one for one in flights if kept(one)]
    told = ", ".join(
        f"`{one.scenario.name}` on `{one.scenario.plant_kind}` with `{one.scenario.gains.profile}`"
        for one in good
    )
    return flights_table(
        "simulation_1_verdicts",
        "Every flight of Simulation 1, the worst UAV of each",
        flights,
        f"All five UAVs keep the deadline and touch nothing in: {told or 'none'}. The printed κ = 1 is too weak "
        "to hold the end of the chain once Ξ has faded, and the printed start asks a quadrotor for more than it has.",
    )
