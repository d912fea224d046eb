"""Simulation 1: five UAVs on the six-input plant, with and without obstacles. Figs. 5-18 and 23."""

from __future__ import annotations

from paper.claims import velocity_claim
from paper.columns import verdicts_table
from paper.experiment_result import ExperimentResult, Figure, Table
from paper.figures import formation, inputs, paths
from paper.flights import PLANTS, PROFILES, JudgedFlight, fly_judged
from paper.output import ExperimentFolder

SCENARIOS = {"paper_5": "", "paper_5_free": ", without obstacles"}


def _flight(scenario: str, profile: str, plant: str = "rigid_body_6dof") -> JudgedFlight:
    return fly_judged(scenario, {"plant.kind": plant, "gains.profile": profile})


def _by_profile(scenario: str) -> dict[str, JudgedFlight]:
    return {profile: _flight(scenario, profile) for profile in PROFILES}


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly, draw and judge Simulation 1."""
    figures: list[Figure] = []
    for first, (scenario, suffix) in enumerate(SCENARIOS.items()):
        output.progress(f"flying {scenario}")
        flights = _by_profile(scenario)
        output.progress(f"drawing {scenario}")
        figures += [
            paths.in_space(output, flights["paper"], 5 + 2 * first, f"in space{suffix}"),
            paths.from_above(output, flights["paper"], 6 + 2 * first, f"from above{suffix}"),
            formation.distances(output, flights, 9 + first, suffix),
            formation.angles(output, flights, 11 + first, suffix),
            formation.leader_yaw(output, flights, 13 + first, suffix),
            inputs.whole_flight(output, flights, 15 + first, suffix),
            inputs.first_second(output, flights, 17 + first, suffix),
        ]
    figures.append(inputs.energy(output, {p: _flight("paper_5", p) for p in ("paper", "soft")}))
    output.progress("flying the quadrotor")
    return ExperimentResult(
        name="simulation_1",
        title="Simulation 1: five UAVs",
        text=(
            "Scenario `paper_5` for 60 s, and `paper_5_free`, the same without its two obstacles. The "
            "figures show the paper's plant, a rigid body with six inputs, under the printed gains "
            "(profile `paper`: Λ = κ = 1); `soft`, our default for flight, and `reference` stand beside it. All "
            "are flown behind the command filter, which the paper does not have: part *Baselines* shows what it does."
        ),
        figures=tuple(sorted(figures, key=lambda figure: figure.name)),
        tables=(_verdicts(),),
        claims=(velocity_claim(_by_profile("paper_5_free")),),
    )


def _verdicts() -> Table:
    flights = [
        _flight(scenario, profile, plant)
        for scenario in SCENARIOS
        for plant in PLANTS
        for profile in PROFILES
    ]
    good = ", ".join(
        f"`{one.scenario.name}` on `{one.scenario.plant.kind}` with `{one.scenario.gains.profile}`"
        for one in flights
        if one.kept_promise()
    )
    return verdicts_table(
        "simulation_1_verdicts",
        "Every flight of Simulation 1, the worst UAV of each",
        flights,
        f"All five UAVs keep the deadline and touch nothing in: {good or 'none'}. The printed κ = 1 is too weak "
        "to hold the end of the chain once Ξ has faded, and the printed start asks a quadrotor for more than it has.",
    )
