"""Ablation: the time base on and off in each of the three loops."""

from __future__ import annotations

from itertools import product

from ptnsbc_tools.reproduce import columns as col
from ptnsbc_tools.reproduce.columns import FlightColumn, flights_table
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult
from ptnsbc_tools.reproduce.experiments.ablation_estimator import worst_estimate_after_tf2
from ptnsbc_tools.reproduce.flights import JudgedFlight, fly_judged
from ptnsbc_tools.reproduce.output import ExperimentFolder

LOOPS = {
    "formation": ("gains.formation.time_base", "gains.attitude.time_base"),
    "estimator": ("gains.estimator.time_base",),
    "controller": ("gains.force.time_base", "gains.torque.time_base"),
}
_DURATION_S = 20.0


def _on(one: JudgedFlight) -> tuple[bool, ...]:
    """Whether each of the loops has its time base."""
    gains = one.scenario.gains
    return (gains.formation.time_base, gains.estimator.time_base, gains.force.time_base)


_COLUMNS = (
    FlightColumn("formation", lambda one: "on" if _on(one)[0] else "off"),
    FlightColumn("estimator", lambda one: "on" if _on(one)[1] else "off"),
    FlightColumn("controller", lambda one: "on" if _on(one)[2] else "off"),
    col.MET,
    col.SETTLED,
    col.ERROR_AT_5_S,
    col.LARGEST_AFTER,
    FlightColumn("estimate after tf2, m", worst_estimate_after_tf2, 4),
    FlightColumn(
        "velocity error after tf3, m/s",
        lambda one: one.velocity_error_after(one.scenario.gains.force.deadline_s),
        3,
    ),
    col.INITIAL_FORCE,
    col.PEAK_INPUT,
    col.ENERGY_BEYOND_HOVER,
)


def _flight(on: tuple[bool, ...], profile: str) -> JudgedFlight:
    """`paper_5_free` on the six-input plant with the time base of some loops switched off."""
    switches = {key: state for keys, state in zip(LOOPS.values(), on, strict=True) for key in keys}
    return fly_judged(
        "paper_5_free",
        {
            "plant.kind": "rigid_body_6dof",
            "gains.profile": profile,
            "timing.duration_s": _DURATION_S,
            **switches,
        },
    )


def _meaning(flights: dict[tuple[bool, ...], JudgedFlight]) -> str:
    """What each loop loses without its time base, from the flights with one of them switched off."""
    costs = []
    for index, loop in enumerate(LOOPS):
        one = flights[tuple(k != index for k in range(len(LOOPS)))]
        lost = len(one.uavs) - one.met()
        costs.append(f"the {loop}'s costs {lost} of {len(one.uavs)} UAVs the deadline")
    bare = flights[(False,) * len(LOOPS)]
    return (
        f"Alone switched off, {', '.join(costs)}. With all three off "
        f"{bare.met_text()} keep it, but the initial force is no longer the weight."
    )


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly all combinations."""
    tables = []
    for profile in ("soft", "paper"):
        flights = {}
        for on in product((True, False), repeat=len(LOOPS)):
            output.progress(f"flying {profile}, {on}")
            flights[on] = _flight(on, profile)
        tables.append(
            flights_table(
                f"ablation_time_base_{profile}",
                f"Time base on and off, profile `{profile}`",
                _COLUMNS,
                flights.values(),
                _meaning(flights),
            )
        )
    return ExperimentResult(
        "ablation_time_base",
        "Ablation: the time base in each loop",
        f"Scenario `paper_5_free` on the six-input plant, {_DURATION_S:g} s. Off means the constant gain "
        "Λκ from the start, without Ξ and without the soft onset.",
        tables=tuple(tables),
    )
