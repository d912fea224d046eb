"""Simulation 1: five UAVs on the six-input plant, with and without obstacles. Figs. 5-18 and 23."""

from __future__ import annotations

from ptnsbc_tools.reproduce import draw_energy, draw_inputs, draw_paths, draw_shape
from ptnsbc_tools.reproduce.claims import formation_claim
from ptnsbc_tools.reproduce.flights import Flown, flown
from ptnsbc_tools.reproduce.part import Column, Figure, Part, Table
from ptnsbc_tools.reproduce.workshop import Workshop

PROFILES = ("paper", "soft", "reference")
PLANTS = ("rigid_body_6dof", "quadrotor")
SCENARIOS = {"paper_5": "", "paper_5_free": ", without obstacles"}


def flight(scenario: str, profile: str, plant: str = "rigid_body_6dof") -> Flown:
    """One of the flights of Simulation 1."""
    return flown(scenario, {"plant.kind": plant, "gains.profile": profile})


def run(workshop: Workshop) -> Part:
    """Fly, draw and judge Simulation 1."""
    figures: list[Figure] = []
    for first, (scenario, suffix) in enumerate(SCENARIOS.items()):
        workshop.tell(f"flying {scenario}")
        by_profile = {profile: flight(scenario, profile) for profile in PROFILES}
        workshop.tell(f"drawing {scenario}")
        figures += [
            draw_paths.in_space(workshop, by_profile["paper"], 5 + 2 * first, suffix),
            draw_paths.from_above(workshop, by_profile["paper"], 6 + 2 * first, suffix),
            draw_shape.distances(workshop, by_profile, 9 + first, suffix),
            draw_shape.angles(workshop, by_profile, 11 + first, suffix),
            draw_shape.leader_yaw(workshop, by_profile, 13 + first, suffix),
            draw_inputs.whole(workshop, by_profile, 15 + first, suffix),
            draw_inputs.first_second(workshop, by_profile, 17 + first, suffix),
        ]
    figures.append(
        draw_energy.energy(workshop, {p: flight("paper_5", p) for p in ("paper", "soft")})
    )
    workshop.tell("flying the quadrotor")
    return Part(
        name="simulation_1",
        title="Simulation 1: five UAVs",
        text=(
            "Scenario `paper_5` for 60 s, and `paper_5_free`, the same without its two obstacles. The "
            "figures show the paper's plant, a rigid body with six inputs, under the printed gains "
            "(profile `paper`: Λ = κ = 1); `soft`, our default for flight, and `reference` stand beside it."
        ),
        figures=tuple(sorted(figures, key=lambda one: one.name)),
        tables=(_verdicts(),),
        claims=tuple(
            formation_claim(scenario, {p: flight(scenario, p) for p in PROFILES})
            for scenario in SCENARIOS
        ),
    )


def _verdicts() -> Table:
    rows = []
    for scenario in SCENARIOS:
        for plant in PLANTS:
            for profile in PROFILES:
                one = flight(scenario, profile, plant)
                rows.append(
                    (
                        scenario,
                        plant,
                        profile,
                        f"{one.met()} of {len(one.verdict.uavs)}",
                        one.settled_s(),
                        one.worst_at_deadline_m(),
                        one.worst_after_m(),
                        one.clearance_m(),
                        one.initial_beyond_hover_n(),
                        one.peak_input(),
                        one.verdict.energy,
                        one.energy_beyond_hover(),
                    )
                )
    return Table(
        "simulation_1_verdicts",
        "Every flight of Simulation 1, worst UAV of each",
        (
            Column("scenario"),
            Column("plant"),
            Column("profile"),
            Column("deadline met"),
            Column("settled, s"),
            Column("error at 5 s, m", 4),
            Column("largest after, m", 4),
            Column("room beyond keep-out, m", 3),
            Column("initial force beyond hover, N", 1),
            Column("peak input", 1),
            Column("energy (54), N²s", 0),
            Column("beyond hover, N²s", 0),
        ),
        tuple(rows),
        "Only `soft` keeps the promise for all five UAVs on both plants: the printed κ = 1 does not hold the end "
        "of the chain within 0.05 m once Ξ has faded, `reference` brings its last UAV in after the "
        "deadline, and the printed start asks a quadrotor for more than it has.",
    )
