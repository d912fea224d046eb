"""Ablation: the residual q and the deadline tf of the formation loop."""

from __future__ import annotations

from collections.abc import Mapping

from ptnsbc_core.timebase import peak_gain
from ptnsbc_tools.reproduce import columns as col
from ptnsbc_tools.reproduce.columns import FlightColumn, flights_table
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, Table
from ptnsbc_tools.reproduce.flights import PLANTS, JudgedFlight, fly_judged
from ptnsbc_tools.reproduce.output import ExperimentFolder

RESIDUALS = (0.2, 0.1, 0.02, 0.01, 0.001, 0.0001)
DEADLINES_S = (3.0, 4.0, 5.0, 7.0, 10.0)
DEFAULT_Q, DEFAULT_TF_S = 0.02, 5.0
_AFTER_S = 10.0

Sweep = Mapping[str, Mapping[float, JudgedFlight]]
"""Flights by plant and by the value that is swept."""

_PLANT = FlightColumn("plant", lambda one: one.scenario.plant_kind)
_COLUMNS = (
    col.MET,
    col.SETTLED,
    FlightColumn("leader at tf, m", lambda one: one.verdict.uavs[0].error_at_deadline_m, 4),
    col.ERROR_AT_5_S._replace(title="worst at tf, m"),
    col.LARGEST_AFTER,
    FlightColumn(
        "saturated until tf, s", lambda one: max(uav.saturated_s for uav in one.verdict.uavs)
    ),
    FlightColumn(
        "peak Ξ, 1/s",
        lambda one: peak_gain(one.deadline_s, one.scenario.gains.formation.residual),
    ),
    col.INITIAL_FORCE,
    col.PEAK_INPUT,
    col.ENERGY_BEYOND_HOVER,
)


def _flight(plant: str, q: float, tf_s: float) -> JudgedFlight:
    """`paper_5_free` under profile `soft` with another residual or deadline."""
    return fly_judged(
        "paper_5_free",
        {
            "plant.kind": plant,
            "gains.formation.residual": q,
            "gains.formation.deadline_s": tf_s,
            "timing.duration_s": tf_s + _AFTER_S,
        },
    )


def _table(
    name: str, title: str, swept: FlightColumn, sweep: Sweep, values: str, more: str
) -> Table:
    """A row for each flight; the meaning begins with the values for which all deadlines are met."""
    met = []
    for plant, flights in sweep.items():
        good = ", ".join(f"{value:g}" for value, one in flights.items() if one.all_met())
        met.append(f"on `{plant}` all deadlines are met for {values.format(good or 'none')}")
    columns = (_PLANT, swept, *_COLUMNS)
    every = [one for flights in sweep.values() for one in flights.values()]
    return flights_table(name, title, columns, every, "; ".join(met).capitalize() + more)


def _by_residual() -> Table:
    return _table(
        "ablation_residual",
        f"Residual q, tf = {DEFAULT_TF_S:g} s",
        FlightColumn("q", lambda one: f"{one.scenario.gains.formation.residual:g}"),
        {plant: {q: _flight(plant, q, DEFAULT_TF_S) for q in RESIDUALS} for plant in PLANTS},
        "q = {}",
        ". After tf only κ is left, and no q changes what follows.",
    )


def _by_deadline() -> Table:
    sweep = {plant: {tf: _flight(plant, DEFAULT_Q, tf) for tf in DEADLINES_S} for plant in PLANTS}
    slow, fast = (sweep[PLANTS[0]][tf] for tf in (10.0, 5.0))
    return _table(
        "ablation_deadline",
        f"Deadline tf, q = {DEFAULT_Q:g}",
        FlightColumn("tf, s", lambda one: f"{one.deadline_s:g}"),
        sweep,
        "tf = {} s",
        f". Half the time, 5 s for 10 s, costs on `{PLANTS[0]}` "
        f"{fast.peak_input() - fast.weight_n:.1f} N at most beyond the weight for "
        f"{slow.peak_input() - slow.weight_n:.1f} N, and {fast.energy_beyond_hover():.0f} N²s "
        f"beyond hover for {slow.energy_beyond_hover():.0f} N²s.",
    )


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly both sweeps."""
    output.progress("sweeping q")
    residual = _by_residual()
    output.progress("sweeping tf")
    return ExperimentResult(
        "ablation_sweeps",
        "Ablation: residual and deadline",
        "Scenario `paper_5_free`, profile `soft`, until 10 s after the deadline.",
        tables=(residual, _by_deadline()),
    )
