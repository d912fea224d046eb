"""Simulation 2: twenty UAVs by the same laws. Figs. 24-31."""

from __future__ import annotations

from ptnsbc_tools.reproduce.claims import kept, limit_claim, shape_claim
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, Figure
from ptnsbc_tools.reproduce.figures import swarm
from ptnsbc_tools.reproduce.flights import UNFILTERED, JudgedFlight, flown
from ptnsbc_tools.reproduce.summary import flights_table

PROFILES = ("paper", "soft", "reference")
PLANTS = ("rigid_body_6dof", "quadrotor")
_BEST = "soft"
_PRINTED = "paper, no command filter"


def flight(profile: str, plant: str = "rigid_body_6dof") -> JudgedFlight:
    """One flight of Simulation 2."""
    return flown("paper_20", {"plant.kind": plant, "gains.profile": profile})


def unfiltered() -> JudgedFlight:
    """The printed law: printed gains and no command filter."""
    return flown(
        "paper_20", {"plant.kind": "rigid_body_6dof", "gains.profile": "paper", **UNFILTERED}
    )


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly, draw and judge Simulation 2."""
    flights = {}
    for profile in PROFILES:
        workshop.tell(f"flying profile {profile}")
        flights[profile] = flight(profile)
    workshop.tell("flying the quadrotor")
    everything = [*flights.values(), *(flight(profile, "quadrotor") for profile in PROFILES)]
    workshop.tell("drawing")
    figures = _figures(workshop, {_PRINTED: unfiltered(), **flights})
    good = [one for one in everything if kept(one)]
    told = ", ".join(f"`{o.scenario.gains.profile}` on `{o.scenario.plant_kind}`" for o in good)
    table = flights_table(
        "simulation_2_verdicts",
        "Every flight of Simulation 2, the worst UAV of each",
        everything,
        f"All twenty UAVs keep the deadline and touch nothing with: {told or 'none'}.",
    )
    return ExperimentResult(
        "simulation_2",
        "Simulation 2: twenty UAVs",
        "Scenario `paper_20`, 60 s: the paper prints neither graph, nor formation, nor starts, so they are ours. "
        f"Trajectories are those of profile `{_BEST}` on the six-input plant; distances and inputs are shown for the "
        "printed gains too, inputs also without the command filter, as printed. The starts are within 0.6 m of a shape "
        "of the same kind; `ptnsbc reproduce --only ablation_starts` measures starts anywhere in the box.",
        figures=figures,
        tables=(table,),
        claims=(
            shape_claim(flights),
            limit_claim({_PRINTED: unfiltered(), **flights}, swarm.LIMIT_N),
        ),
    )


def _figures(workshop: ExperimentFolder, flights: dict[str, JudgedFlight]) -> tuple[Figure, ...]:
    shown = {name: flights[name] for name in ("paper", _BEST)}
    pushed = {_PRINTED: flights[_PRINTED], **shown}
    uavs = flights[_BEST].scenario.uav_ids
    fives = [uavs[first : first + 5] for first in range(0, len(uavs), 5)]
    return (
        swarm.in_space(workshop, flights[_BEST], 24),
        swarm.from_above(workshop, flights[_BEST], 25),
        swarm.distance_error(workshop, shown, 26),
        swarm.inputs(workshop, pushed, 27),
        *(swarm.five(workshop, pushed, 28 + k, five) for k, five in enumerate(fives)),
    )
