"""Tables with one row for each flight, and the columns that several experiments show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from paper.experiment_result import Cell, Column, Table
from paper.flights import JudgedFlight


class FlightColumn(NamedTuple):
    """A column of a table with one row for each flight."""

    title: str
    value: Callable[[JudgedFlight], Cell]
    digits: int = 2


MET = FlightColumn("met", JudgedFlight.met_text)
SETTLED = FlightColumn("settled, s", JudgedFlight.settled_s)
ERROR_AT_5_S = FlightColumn("error at 5 s, m", JudgedFlight.worst_at_deadline_m, 4)
ERROR_AT_TF = ERROR_AT_5_S._replace(title="error at tf, m")
LARGEST_AFTER = FlightColumn("largest after, m", JudgedFlight.worst_after_m, 4)
LARGEST_AFTER_ALL = FlightColumn("with excused spans, m", JudgedFlight.worst_after_all_m, 4)
EXCUSED = FlightColumn("excused, s", JudgedFlight.encounter_s, 1)
ROOM = FlightColumn("room beyond keep-out, m", JudgedFlight.clearance_m, 3)
INITIAL_FORCE = FlightColumn("initial force beyond hover, N", JudgedFlight.initial_beyond_hover_n)
PEAK_INPUT = FlightColumn("peak input", JudgedFlight.peak_input, 1)
ENERGY = FlightColumn("energy (54), N²s", lambda one: one.verdict.energy, 0)
BEYOND_HOVER = FlightColumn("beyond hover, N²s", JudgedFlight.energy_beyond_hover, 0)
REASON = FlightColumn("worst UAV that is not met", JudgedFlight.missed_reason)

_VERDICT_COLUMNS = (
    FlightColumn("scenario", lambda one: one.scenario.name),
    FlightColumn("plant", lambda one: one.scenario.plant.kind),
    FlightColumn("profile", lambda one: one.scenario.gains.profile),
    FlightColumn("tolerance, m", lambda one: one.verdict.uavs[0].tolerance_m),
    MET,
    SETTLED,
    ERROR_AT_TF,
    LARGEST_AFTER,
    LARGEST_AFTER_ALL,
    EXCUSED,
    ROOM,
    INITIAL_FORCE._replace(digits=1),
    PEAK_INPUT,
    ENERGY,
    BEYOND_HOVER,
    REASON,
)


def flights_table(
    name: str,
    title: str,
    columns: Sequence[FlightColumn],
    flights: Iterable[JudgedFlight],
    meaning: str,
) -> Table:
    """A table with one row for each flight."""
    heads = tuple(Column(column.title, column.digits) for column in columns)
    rows = tuple(tuple(column.value(one) for column in columns) for one in flights)
    return Table(name, title, heads, rows, meaning)


def verdicts_table(name: str, title: str, flights: Iterable[JudgedFlight], meaning: str) -> Table:
    """Verdicts of flights and what they cost, the worst UAV of each."""
    return flights_table(name, title, _VERDICT_COLUMNS, flights, meaning)
