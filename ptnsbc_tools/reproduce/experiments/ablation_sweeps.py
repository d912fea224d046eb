"""Ours, taken apart: the residual q and the deadline tf of the formation loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ptnsbc_core.timebase import peak_gain
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import Cell, Column, ExperimentResult, Table
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown

RESIDUALS = (0.2, 0.1, 0.02, 0.01, 0.001, 0.0001)
DEADLINES_S = (3.0, 4.0, 5.0, 7.0, 10.0)
DEFAULT_Q, DEFAULT_TF_S = 0.02, 5.0
PLANTS = ("rigid_body_6dof", "quadrotor")
_AFTER_S = 10.0

Swept = Mapping[str, Mapping[float, JudgedFlight]]
"""Flights by plant and by the value that is swept."""

_COLUMNS = (
    Column("deadline met"),
    Column("settled, s"),
    Column("leader at tf, m", 4),
    Column("worst at tf, m", 4),
    Column("largest after, m", 4),
    Column("saturated until tf, s"),
    Column("peak Ξ, 1/s"),
    Column("initial force beyond hover, N"),
    Column("peak input", 1),
    Column("energy beyond hover, N²s", 0),
)


def flight(plant: str, q: float, tf_s: float) -> JudgedFlight:
    """`paper_5_free` under profile `soft` with another residual or deadline."""
    return flown(
        "paper_5_free",
        {
            "plant.kind": plant,
            "gains.formation.residual": q,
            "gains.formation.deadline_s": tf_s,
            "timing.duration_s": tf_s + _AFTER_S,
        },
    )


def _row(plant: str, first: Cell, one: JudgedFlight, gain: float) -> tuple[Cell, ...]:
    uavs = one.verdict.uavs
    return (
        plant,
        first,
        f"{one.met()} of {len(uavs)}",
        one.settled_s(),
        uavs[0].error_at_deadline_m,
        one.worst_at_deadline_m(),
        one.worst_after_m(),
        max(uav.saturated_s for uav in uavs),
        gain,
        one.initial_beyond_hover_n(),
        one.peak_input(),
        one.energy_beyond_hover(),
    )


def _met(flights: Mapping[float, JudgedFlight]) -> str:
    """For which values all UAVs kept the deadline."""
    good = [value for value, one in flights.items() if one.met() == len(one.verdict.uavs)]
    return ", ".join(f"{value:g}" for value in good) if good else "none"


def _rows(flights: Swept, peak: Callable[[float], float]) -> tuple[tuple[Cell, ...], ...]:
    """A row for each flight; `peak` is the largest gain at a value."""
    return tuple(
        _row(plant, f"{value:g}", one, peak(value))
        for plant, some in flights.items()
        for value, one in some.items()
    )


def _promise(flights: Swept, values: str) -> str:
    """On which plant the deadlines are met for which values."""
    said = (
        f"on `{plant}` all deadlines are met for {values.format(_met(some))}"
        for plant, some in flights.items()
    )
    return "; ".join(said).capitalize()


def _by_residual() -> Table:
    flights = {plant: {q: flight(plant, q, DEFAULT_TF_S) for q in RESIDUALS} for plant in PLANTS}
    rows = _rows(flights, lambda q: peak_gain(DEFAULT_TF_S, q))
    return Table(
        "ablation_residual",
        f"Residual q, tf = {DEFAULT_TF_S:g} s",
        (Column("plant"), Column("q"), *_COLUMNS),
        rows,
        _promise(flights, "q = {}") + ". After tf only κ is left, and no q changes what follows.",
    )


def _by_deadline() -> Table:
    flights = {plant: {tf: flight(plant, DEFAULT_Q, tf) for tf in DEADLINES_S} for plant in PLANTS}
    rows = _rows(flights, lambda tf: peak_gain(tf, DEFAULT_Q))
    body = flights[PLANTS[0]]
    slow, fast = body[10.0], body[5.0]
    return Table(
        "ablation_deadline",
        f"Deadline tf, q = {DEFAULT_Q:g}",
        (Column("plant"), Column("tf, s"), *_COLUMNS),
        rows,
        _promise(flights, "tf = {} s") + f". Half the time, 5 s for 10 s, costs on `{PLANTS[0]}` "
        f"{fast.peak_input() - fast.weight_n:.1f} N at most beyond the weight for "
        f"{slow.peak_input() - slow.weight_n:.1f} N, and {fast.energy_beyond_hover():.0f} N²s "
        f"beyond hover for {slow.energy_beyond_hover():.0f} N²s.",
    )


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly both sweeps."""
    workshop.tell("sweeping q")
    residual = _by_residual()
    workshop.tell("sweeping tf")
    return ExperimentResult(
        "ablation_sweeps",
        "Ablation: residual and deadline",
        "Scenario `paper_5_free`, profile `soft`, until 10 s after the deadline.",
        tables=(residual, _by_deadline()),
    )
