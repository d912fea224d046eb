"""One row per flight: kept or not, and what it cost. The table that every simulation ends with."""

from __future__ import annotations

from collections.abc import Iterable

from ptnsbc_tools.reproduce.experiment_result import Cell, Column, Table
from ptnsbc_tools.reproduce.flights import JudgedFlight

_COLUMNS = (
    Column("scenario"),
    Column("plant"),
    Column("profile"),
    Column("tolerance, m"),
    Column("deadline met"),
    Column("settled, s"),
    Column("error at tf, m", 4),
    Column("largest after, m", 4),
    Column("room beyond keep-out, m", 3),
    Column("initial force beyond hover, N", 1),
    Column("peak input", 1),
    Column("energy (54), N²s", 0),
    Column("beyond hover, N²s", 0),
    Column("worst UAV that missed it"),
)


def _row(one: JudgedFlight) -> tuple[Cell, ...]:
    return (
        one.scenario.name,
        one.scenario.plant_kind,
        one.scenario.gains.profile,
        one.verdict.uavs[0].tolerance_m,
        f"{one.met()} of {len(one.verdict.uavs)}",
        one.settled_s(),
        one.worst_at_deadline_m(),
        one.worst_after_m(),
        one.clearance_m(),
        one.initial_beyond_hover_n(),
        one.peak_input(),
        one.verdict.energy,
        one.energy_beyond_hover(),
        reason(one),
    )


def flights_table(name: str, title: str, flights: Iterable[JudgedFlight], meaning: str) -> Table:
    """Verdicts of flights, the worst UAV of each."""
    return Table(name, title, _COLUMNS, tuple(_row(one) for one in flights), meaning)


def reason(one: JudgedFlight) -> str:
    """Why the worst UAV lost the deadline; empty when all kept it."""
    missed = [uav for uav in one.verdict.uavs if uav.verdict != "met"]
    if not missed:
        return ""
    worst = max(missed, key=lambda uav: uav.error_at_deadline_m or 0.0)
    return f"UAV {worst.uav} {worst.verdict}: {worst.reason}"
