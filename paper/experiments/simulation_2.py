"""Simulation 2: twenty UAVs by the same laws. Figs. 24-31."""

from __future__ import annotations

from paper.claims import twenty_inputs_claim
from paper.columns import verdicts_table
from paper.experiment_result import ExperimentResult, Figure
from paper.figures import formation, inputs, paths
from paper.flights import PROFILES, UNFILTERED, JudgedFlight, fly_judged
from paper.output import ExperimentFolder

_BEST = "soft"
_PRINTED = "paper, no command filter"


def _flight(profile: str, plant: str = "rigid_body_6dof", filtered: bool = True) -> JudgedFlight:
    changes = {"plant.kind": plant, "gains.profile": profile}
    return fly_judged("paper_20", changes if filtered else {**changes, **UNFILTERED})


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly, draw and judge Simulation 2."""
    flights = {}
    for profile in PROFILES:
        output.progress(f"flying profile {profile}")
        flights[profile] = _flight(profile)
    output.progress("flying the quadrotor")
    both_plants = [*flights.values(), *(_flight(profile, "quadrotor") for profile in PROFILES)]
    output.progress("drawing")
    with_printed = {_PRINTED: _flight("paper", filtered=False), **flights}
    figures = _figures(output, with_printed)
    good = ", ".join(
        f"`{one.scenario.gains.profile}` on `{one.scenario.plant.kind}`"
        for one in both_plants
        if one.kept_promise()
    )
    table = verdicts_table(
        "simulation_2_verdicts",
        "Every flight of Simulation 2, the worst UAV of each",
        both_plants,
        f"All twenty UAVs keep the deadline and touch nothing with: {good or 'none'}.",
    )
    return ExperimentResult(
        "simulation_2",
        "Simulation 2: twenty UAVs",
        "Scenario `paper_20`, 60 s: the paper prints neither graph, nor formation, nor starts, so they are ours. "
        f"Trajectories are those of profile `{_BEST}` on the six-input plant; distances and inputs are shown for the "
        "printed gains too, inputs also without the command filter, as printed. The starts are within 0.6 m of a shape "
        "of the same kind; part *Ablations* measures starts anywhere in a box.",
        figures=figures,
        tables=(table,),
        claims=(twenty_inputs_claim(with_printed, inputs.PAPER_LIMIT_N),),
    )


def _figures(output: ExperimentFolder, flights: dict[str, JudgedFlight]) -> tuple[Figure, ...]:
    best = flights[_BEST]
    shown = {name: flights[name] for name in (_PRINTED, "paper", _BEST)}
    filtered = {name: flights[name] for name in ("paper", _BEST)}
    fives = [best.uavs[first : first + 5] for first in range(0, len(best.uavs), 5)]
    return (
        paths.in_space(output, best, 24, "of 20 UAVs in space"),
        paths.from_above(output, best, 25, "of 20 UAVs from above", telling=True),
        formation.distance_errors(output, filtered, 26),
        inputs.with_limit(output, shown, 27),
        *(inputs.five_uavs(output, shown, 28 + k, five) for k, five in enumerate(fives)),
    )
