"""Ours, taken apart: the time base on and off in each of the three loops."""

from __future__ import annotations

from itertools import product

from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import Cell, Column, ExperimentResult, Table
from ptnsbc_tools.reproduce.experiments.ablation_estimator import worst_from
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown

LOOPS = {
    "formation": ("gains.formation.time_base", "gains.attitude.time_base"),
    "estimator": ("gains.estimator.time_base",),
    "controller": ("gains.force.time_base", "gains.torque.time_base"),
}
_DURATION_S = 20.0


def flight(on: tuple[bool, ...], profile: str = "soft") -> JudgedFlight:
    """`paper_5_free` on the six-input plant with the time base of some loops switched off."""
    switches = {key: way for keys, way in zip(LOOPS.values(), on, strict=True) for key in keys}
    return flown(
        "paper_5_free",
        {
            "plant.kind": "rigid_body_6dof",
            "gains.profile": profile,
            "timing.duration_s": _DURATION_S,
            **switches,
        },
    )


def _row(on: tuple[bool, ...], one: JudgedFlight) -> tuple[Cell, ...]:
    gains = one.scenario.gains
    return (
        *("on" if way else "off" for way in on),
        f"{one.met()} of {len(one.verdict.uavs)}",
        one.settled_s(),
        one.worst_at_deadline_m(),
        one.worst_after_m(),
        worst_from(one, gains.estimator.deadline_s),
        one.velocity_error_after(gains.force.deadline_s),
        one.initial_beyond_hover_n(),
        one.peak_input(),
        one.energy_beyond_hover(),
    )


def _meaning(flights: dict[tuple[bool, ...], JudgedFlight]) -> str:
    """Which loops cannot do without, from the flights with one of them switched off."""
    needed = []
    for index, loop in enumerate(LOOPS):
        way = tuple(k != index for k in range(len(LOOPS)))
        one = flights[way]
        lost = len(one.verdict.uavs) - one.met()
        needed.append(f"the {loop}'s costs {lost} of {len(one.verdict.uavs)} UAVs the deadline")
    bare = flights[(False,) * len(LOOPS)]
    return (
        f"Alone switched off, {', '.join(needed)}. With all three off "
        f"{bare.met()} of {len(bare.verdict.uavs)} keep it, but the initial force is no longer the weight."
    )


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly all combinations."""
    tables = []
    for profile in ("soft", "paper"):
        flights = {}
        for on in product((True, False), repeat=len(LOOPS)):
            workshop.tell(f"flying {profile}, {on}")
            flights[on] = flight(on, profile)
        tables.append(_table(profile, flights))
    return ExperimentResult(
        "ablation_time_base",
        "Ablation: the time base in each loop",
        f"Scenario `paper_5_free` on the six-input plant, {_DURATION_S:g} s. Off means the constant gain "
        "Λκ from the start, without Ξ and without the soft onset.",
        tables=tuple(tables),
    )


def _table(profile: str, flights: dict[tuple[bool, ...], JudgedFlight]) -> Table:
    return Table(
        f"ablation_time_base_{profile}",
        f"Time base on and off, profile `{profile}`",
        (
            *(Column(loop) for loop in LOOPS),
            Column("deadline met"),
            Column("settled, s"),
            Column("error at 5 s, m", 4),
            Column("largest after, m", 4),
            Column("estimate after tf2, m", 4),
            Column("velocity error after tf3, m/s", 3),
            Column("initial force beyond hover, N"),
            Column("peak input", 1),
            Column("energy beyond hover, N²s", 0),
        ),
        tuple(_row(on, one) for on, one in flights.items()),
        _meaning(flights),
    )
