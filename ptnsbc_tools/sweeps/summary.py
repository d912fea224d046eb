"""The result of a sweep: shares, causes, errors and the worst flights, as tables and as JSON."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from arro3.core import DataType
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from ptnsbc_core.types import Array
from ptnsbc_sim.sweep.draws import NORMAL, UNIFORM, VALUES, SweepError
from ptnsbc_sim.sweep.dry_run import ACCEPTED, REFUSED
from ptnsbc_sim.sweep.plan import SweepPlan
from ptnsbc_sim.sweep.rows import MARGINS, NOT_FLOWN, UNITS, SweepRow
from ptnsbc_sim.sweep.runner import DRAWN, PLAN, TABLE, read_table
from ptnsbc_sim.verdict.deadline import KEPT, MET, MET_LATE, MISSED, VIOLATED
from ptnsbc_tools import console
from ptnsbc_tools.tables import Summary, length, new_table, word

WIDE = 0.2
"""An interval wider than this is called wide."""


@dataclass(frozen=True)
class Share:
    """`count` of `of`, and the Wilson interval of the probability at 95 %."""

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself; NaN of nothing."""
        return self.count / self.of if self.of else float("nan")

    @property
    def wide(self) -> bool:
        """True if the interval says little: fly more."""
        return self.high - self.low > WIDE

    @property
    def interval(self) -> str:
        """`43.3 to 81.9 %`; one bound where the count is none or all."""
        digits = 1 if self.high - self.low > 0.01 else 3
        if self.count == 0:
            return f"at most {100 * self.high:.{digits}f} %"
        if self.count == self.of:
            return f"at least {100 * self.low:.{digits}f} %"
        return f"{100 * self.low:.1f} to {100 * self.high:.1f} %"

    def __str__(self) -> str:
        if not self.of:
            return "0 of 0"
        wide = ", wide" if self.wide else ""
        return f"{self.count} of {self.of}, {100 * self.value:.1f} % ({self.interval}{wide})"

    def as_json(self) -> dict[str, Any]:
        """As plain data; null where there are no flights."""
        share = {"share": self.value if self.of else None}
        bounds = {"low": self.low, "high": self.high, "wide": self.wide}
        return {"count": self.count, "of": self.of, **share, **bounds}


def share(count: int, of: int) -> Share:
    """A share with its Wilson interval."""
    from scipy.stats import binomtest

    if not of:
        return Share(0, 0, 0.0, 1.0)
    found = binomtest(count, of).proportion_ci(method="wilson")
    return Share(count, of, float(found.low), float(found.high))


def share_of(met: NDArray[np.bool_]) -> Share:
    """The share of True."""
    return share(int(np.sum(met)), len(met))


Column = NDArray[Any]

ERRORS = (
    ("error at tf", "error_at_deadline_m"),
    ("largest after tf, without excused spans", "largest_after_m"),
    ("largest after tf, with excused spans", "largest_after_all_m"),
)
DISTANCES = (
    ("closest pair of UAVs", "closest_uav_m"),
    ("room to the closest obstacle", "closest_obstacle_m"),
)
_INFINITE = (*(name for _, name in ERRORS), "rmse_after_m")
"""Columns in which NaN is an error that is not finite; None is no figure."""


@dataclass(frozen=True)
class Flights:
    """One value (D,) for each flight."""

    draw: NDArray[np.int64]
    met: NDArray[np.bool_]  # late or not
    in_place: NDArray[np.bool_]  # all UAVs at the deadline, whatever excuses the others
    verdict: Column
    check: Column  # accepted | refused, empty without dry runs
    worst: NDArray[np.int64]  # row of the UAV to look at: inside a keep-out, not met, largest error


@dataclass(frozen=True)
class FlightTable:
    """Rows of UAVs, sorted by draw."""

    columns: Mapping[str, Column]  # (R,)

    def __getitem__(self, name: str) -> Column:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["draw"])

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """The first row of every flight."""
        return np.unique(self["draw"], return_index=True)[1]

    @cached_property
    def flights(self) -> Flights:
        """The flights, in the order of their draws."""
        verdict = self["flight_verdict"][self.first]
        return Flights(
            draw=self["draw"][self.first],
            met=np.isin(verdict, KEPT),
            in_place=np.logical_and.reduceat(
                [value is not False for value in self["in_place"].tolist()], self.first
            ),
            verdict=verdict,
            check=self["check"][self.first],
            worst=self._worst(),
        )

    def of_flights(self, name: str) -> Array:
        """A figure of each flight (D,): of a distance or a margin the least of its UAVs, else the largest.

        NaN when none has it; an infinite error was not finite.
        """
        least = name in MARGINS or any(name == distance for _, distance in DISTANCES)
        return (np.fmin if least else np.fmax).reduceat(self[name], self.first)

    def _worst(self) -> NDArray[np.int64]:
        errors = np.nan_to_num(self["largest_after_all_m"], nan=-1.0, posinf=np.inf)
        rank = _rank(self["verdict"])
        ends = [*self.first[1:], len(self)]
        found = [
            begin + int(np.lexsort((errors[begin:end], -rank[begin:end]))[-1])
            for begin, end in zip(self.first, ends, strict=True)
        ]
        return np.array(found, dtype=np.int64)

    @property
    def different(self) -> int:
        """Flights that differ from each other: flights with the same energy of every UAV are the same flight."""
        return len({part.tobytes() for part in np.split(self["energy_n2_s"], self.first[1:])})

    @property
    def drawn(self) -> dict[str, Column]:
        """The drawn values of each flight (D,), by key."""
        names = [name for name in self.columns if name.startswith(DRAWN)]
        return {name.removeprefix(DRAWN): self[name][self.first] for name in names}


def _rank(verdicts: Column) -> NDArray[np.int64]:
    """The order in which UAVs and flights (R,) are looked at: inside a keep-out, not met, late, met."""
    late, met = verdicts == MET_LATE, verdicts == MET
    return np.select([verdicts == VIOLATED, late, met], [0, 2, 3], 1)


@dataclass(frozen=True)
class FlownSweep:
    """A sweep that was flown, from its folder."""

    plan: SweepPlan
    folder: Path
    table: FlightTable
    not_flown: tuple[tuple[int, str], ...] = ()  # draw and cause of those that cannot be flown

    @property
    def missing(self) -> int:
        """Draws without a flight."""
        return self.plan.draws - len(self.table.flights.draw)


def plan_in(folder: Path) -> SweepPlan:
    """The plan of a sweep from its folder; SweepError when there is none, or it cannot be read."""
    path = folder / PLAN
    try:
        return SweepPlan.from_json(path.read_text(encoding="utf-8"))
    except OSError:
        raise SweepError(f"{folder}: no sweep: expected a folder with {PLAN}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise SweepError(f"{path}: no plan of a sweep: {error}") from None


def read_sweep(folder: Path, *, strict: bool = False) -> FlownSweep:
    """A sweep from its folder; SweepError when it is none, or it is not complete.

    `strict`: UAVs that gave way and came late have missed.
    """
    plan = plan_in(folder)
    path = folder / TABLE
    if not path.is_file():
        raise SweepError(
            f"{folder}: the sweep was ended early: expected {TABLE}; the command that began it continues"
        )
    try:
        table = read_table(path.read_bytes())
    except (OSError, ValueError) as error:
        raise SweepError(f"{path}: cannot be read: {error}") from None
    lacking = [field.name for field in fields(SweepRow) if field.name not in table.column_names]
    if lacking:
        raise SweepError(f"{path}: lacks the columns {', '.join(lacking)}: fly the sweep again")
    if not len(table):
        raise SweepError(f"{path}: holds no flight: fly the sweep again")
    flown = [verdict != NOT_FLOWN for verdict in table["verdict"].to_pylist()]
    rows = zip(table["draw"].to_pylist(), table["cause"].to_pylist(), flown, strict=True)
    lost = tuple((draw, cause) for draw, cause, was_flown in rows if not was_flown)
    if not any(flown):
        raise SweepError(f"{folder}: no draw could be flown: {lost[0][1]}")
    columns = {
        field.name: _column(
            field.name,
            [*compress(table[field.name].to_pylist(), flown)],
            DataType.is_floating(field.type),
        )
        for field in map(table.field, table.column_names)
    }
    for name in ("verdict", "flight_verdict") if strict else ():
        columns[name] = np.where(columns[name] == MET_LATE, MISSED, columns[name])
    return FlownSweep(plan, folder, FlightTable(columns), lost)


def _column(name: str, values: Sequence[Any], floating: bool) -> Column:
    if not floating:
        return np.array(values)
    column = np.array(values, np.float64)  # an empty cell becomes NaN
    if name in _INFINITE:
        column[[value is not None and value != value for value in values]] = np.inf
    return column


def table_of(rows: list[SweepRow]) -> FlightTable:
    """The rows of flights that were not flown by a sweep."""
    columns = {
        field.name: _column(field.name, values, "float" in str(field.type))
        for field, *values in zip(fields(SweepRow), *(astuple(row) for row in rows), strict=True)
    }
    return FlightTable(columns)


_WORST = 5
_MOST_CELLS = 40
_UAV = re.compile(r"\b(uav|UAV )\d+")
_NUMBER = re.compile(r"(?<![A-Za-z])\d+(?:\.\d+)?(?:e[-+]?\d+)?")

_UPWARD = (
    ("settled", "settling_s"),
    *ERRORS,
    ("RMSE after tf, without excused spans", "rmse_after_m"),
    ("outside the band after tf, excused", "excused_outside_s"),
    ("back in place after an encounter", "regained_s"),
    ("promised for it", "recovery_s"),
    ("saturated until tf", "saturated_s"),
    ("peak force", "peak_force_n"),
    ("energy (54)", "energy_n2_s"),
)


@dataclass(frozen=True)
class WorstFlight:
    """A flight to look at, and the command that flies it again."""

    draw: int
    uav: int
    verdict: str
    cause: str
    largest_after_all_m: float | None
    command: str


def number(value: Any) -> float | None:
    """A finite number, else None: JSON has no others."""
    return float(value) if np.isfinite(value) else None


def causes(sweep: FlownSweep) -> list[tuple[str, str, int]]:
    """Verdict, cause without its numbers, and UAVs, the most frequent first."""
    table = sweep.table
    found = Counter(
        (str(verdict), _NUMBER.sub("…", _UAV.sub(r"\1…", str(cause))))
        for verdict, cause in zip(table["verdict"], table["cause"], strict=True)
        if verdict != MET
    )
    return [(verdict, cause, count) for (verdict, cause), count in found.most_common()]


def worst(sweep: FlownSweep, count: int = _WORST) -> list[WorstFlight]:
    """The flights to look at: inside a keep-out first, then not met, late, and the largest error after tf."""
    flights, table = sweep.table.flights, sweep.table
    errors = table.of_flights("largest_after_all_m")
    ranked = np.nan_to_num(errors, nan=-1.0, posinf=np.inf)
    order = np.lexsort((flights.draw, -ranked, _rank(flights.verdict)))[:count]
    return [
        WorstFlight(
            draw=int(flights.draw[k]),
            uav=int(table["uav"][flights.worst[k]]),
            verdict=str(flights.verdict[k]),
            cause=str(table["cause"][flights.worst[k]]),
            largest_after_all_m=number(errors[k]),
            command=_again(sweep, int(flights.draw[k])),
        )
        for k in order
    ]


def _again(sweep: FlownSweep, draw: int, program: str = "ptnsbc") -> str:
    return shlex.join([program, "simulate", "--sweep", str(sweep.folder), "--draw", str(draw)])


def look_first(sweep: FlownSweep, count: int = 1) -> Iterator[str]:
    """The worst flights and the one with the closest pair, a line each with the command that flies it again."""
    for flight in worst(sweep, count):
        off = flight.largest_after_all_m
        error = "" if off is None else f", later {length(off)} off"
        again = _again(sweep, flight.draw, console.program())
        yield f"worst: draw {flight.draw} ({flight.verdict}{error}): {again}"
    apart = sweep.table.of_flights("closest_uav_m")
    if np.isfinite(apart).any():
        k = int(np.nanargmin(apart))
        draw = int(sweep.table.flights.draw[k])
        again = _again(sweep, draw, console.program())
        yield f"closest UAVs: draw {draw} ({length(apart[k])}): {again}"


class Quantiles(NamedTuple):
    """Three values of a figure over UAVs or flights, below which shares of them lie; none is interpolated."""

    label: str
    name: str
    unit: str
    having: int  # UAVs or flights that have it
    values: tuple[float, ...]


def _quantiles(sweep: FlownSweep) -> Iterator[tuple[bool, Quantiles]]:
    """Whether it is of flights, not UAVs, and the quantiles of each figure that any of them has.

    Of UAVs median, 95 % and largest; of flights, whose figures are distances, least, 1 % and median.
    """
    for of_flight, figures, shares in (
        (False, _UPWARD, (0.5, 0.95, 1.0)),
        (True, DISTANCES, (0.0, 0.01, 0.5)),
    ):
        for label, name in figures:
            values = sweep.table.of_flights(name) if of_flight else sweep.table[name]
            kept = np.sort(values[~np.isnan(values)])
            if len(kept):
                places = (min(int(share * len(kept)), len(kept) - 1) for share in shares)
                quantiles = tuple(float(kept[k]) for k in places)
                yield of_flight, Quantiles(label, name, UNITS[name], len(kept), quantiles)


def flights_met(sweep: FlownSweep) -> Share:
    """Flights whose UAVs all met the deadline and kept their distances."""
    return share_of(sweep.table.flights.met)


def shares(sweep: FlownSweep) -> dict[str, Share]:
    """Shares of UAVs and flights that met the deadline, by the keys of the JSON.

    Met counts those that gave way and came within the promise; in place does not. UAVs of one flight are not
    independent. A deadlock is one in which avoidance left a UAV no way to its place for `gains.clearance.deadlock_s`.
    """
    flights, verdicts = sweep.table.flights, sweep.table["verdict"]
    expected = [value for value in sweep.table["in_place"].tolist() if value is not None]
    return {
        "flights": flights_met(sweep),
        "flights_in_place": share_of(flights.in_place),
        "uavs": share_of(np.isin(verdicts, KEPT)),
        "uavs_in_place": share_of(np.array(expected)),
        "uavs_late": share_of(verdicts == MET_LATE),
        "inside_keep_out": share_of(flights.verdict == VIOLATED),
        "deadlocks": share_of(sweep.table.of_flights("deadlock_s") > 0.0),
    }


def dry_runs(sweep: FlownSweep) -> dict[str, Share]:
    """The agreement of the dry runs with the flights that followed; empty without dry runs."""
    flights = sweep.table.flights
    accepted, refused = flights.check == ACCEPTED, flights.check == REFUSED
    if not accepted.any() and not refused.any():
        return {}
    return {
        "accepted by the dry run": share_of(accepted),
        "accepted flights met": share_of(flights.met[accepted]),
        "accepted and not met (silent), of all": share_of(accepted & ~flights.met),
        "refused flights that would have met": share_of(flights.met[refused]),
    }


def cells(sweep: FlownSweep) -> list[tuple[dict[str, Any], Share]]:
    """The share of flights in each cell of the grid; empty without a grid."""
    plan, flights = sweep.plan, sweep.table.flights
    if plan.cells < 2:
        return []
    drawn = sweep.table.drawn
    found = []
    for cell in range(plan.cells):
        inside = np.flatnonzero(flights.draw % plan.cells == cell)
        if len(inside):
            values = {axis.key: drawn[axis.key][inside[0]].item() for axis in plan.grid}
            found.append((values, share_of(flights.met[inside])))
    return found


def _row(one: Share) -> dict[str, Any]:
    bounds = {"low": 100.0 * one.low, "high": 100.0 * one.high}
    return {"count": one.count, "of": one.of, "share [%]": 100.0 * one.value, **bounds}


def title(sweep: FlownSweep) -> str:
    """The flights of a sweep, in a line; what varies as options take it."""
    plan, drawn = sweep.plan, []
    for axis in plan.axes:
        between = {UNIFORM: ":", NORMAL: "±", VALUES: ","}[axis.kind]
        shown = (f"{value:g}" if isinstance(value, float) else str(value) for value in axis.values)
        drawn.append(f"{axis.key}={between.join(shown)}")
    if plan.starts.kind != "file":
        numbers = ",".join(f"{value:g}" for value in plan.starts.numbers)
        drawn.append(f"starts {plan.starts.kind}:{numbers}")
    varied = f"; {', '.join(drawn)}" if drawn else ""
    part = "" if plan.stop_after_s is None else f", the first {plan.stop_after_s:g} s"
    flights = f"{plan.draws} flights" + (", the worst of a search" if plan.points else "")
    return f"{plan.name}: {flights}{part}, seed {plan.seed}{varied}"


def _digits(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e5 else f"{value:.2e}"


def summary_of(sweep: FlownSweep) -> Summary:
    """The shares of a sweep, with their Wilson intervals."""
    names = (
        *("flights met", "flights in place at the deadline"),
        *("UAVs met", "UAVs in place at the deadline", "UAVs met late"),
        *("flights inside a keep-out", "flights with a deadlock"),
    )
    named = dict(zip(names, shares(sweep).values(), strict=True)) | dry_runs(sweep)
    return Summary(title(sweep), tuple({"": name, **_row(one)} for name, one in named.items()))


def _cells_table(sweep: FlownSweep) -> Table | None:
    found = cells(sweep)
    if not found:
        return None
    rows = tuple({**values, **_row(one)} for values, one in found[:_MOST_CELLS])
    table = Summary("Flights of each cell of the grid", rows).table()
    if len(found) > _MOST_CELLS:
        table.caption = f"{len(found) - _MOST_CELLS} more cells: --json, or the table"
    return table


def tables(sweep: FlownSweep, *, brief: bool = False) -> list[Table]:
    """All tables, or those of the first screen, in the order in which they are read, without the empty ones."""
    why = new_table("Why UAVs are late or not met", ("", "UAVs", "cause"))
    for verdict, cause, count in causes(sweep):
        why.add_row(word(verdict), str(count), cause)
    figures = new_table(
        "Errors and effort", ("all UAVs", "unit", "UAVs", "median", "95 %", "largest")
    )
    distances = new_table("Distances", ("each flight", "unit", "flights", "least", "1 %", "median"))
    for of_flight, of in _quantiles(sweep):
        style = "bold red" if of_flight and of.values[0] < 0.0 else ""
        table = distances if of_flight else figures
        table.add_row(of.label, of.unit, str(of.having), *map(_digits, of.values), style=style)
    # The share of what was looked for is no share of flights.
    searched = bool(sweep.plan.points)
    first = [why] if searched else [summary_of(sweep).table(), _cells_table(sweep), why]
    every = [*first, distances] if brief else [*first, figures, distances]
    return [table for table in every if table is not None and (table.row_count or table is figures)]


def line(sweep: FlownSweep) -> Text:
    """The last line: the share of flights in a sentence."""
    flown = flights_met(sweep)
    if sweep.plan.points:
        return Text(f"Of the worst flights of the search {flown.count} of {flown.of} met")
    text = Text(f"Flights met: {flown}")
    text.append(f"; in place at the deadline: {share_of(sweep.table.flights.in_place)}")
    if sweep.table.different < flown.of:
        kinds = f"{sweep.table.different} of these flights are different"
        told = "all are the same flight" if sweep.table.different == 1 else f"only {kinds}"
        text.append(f"; {told}: draw --starts near:0.3, or --vary a range", "bold red")
    if sweep.missing:
        text.append(f"; {sweep.missing} of {sweep.plan.draws} draws were not flown", "bold red")
    return text


def as_json(sweep: FlownSweep) -> dict[str, Any]:
    """The summary as plain data."""
    keys = {False: ("median", "p95", "max"), True: ("min", "p1", "median")}
    figures = {
        of.name: {"unit": of.unit} | dict(zip(keys[of_flight], map(number, of.values), strict=True))
        for of_flight, of in _quantiles(sweep)
    }
    return {
        "name": sweep.plan.name,
        "seed": sweep.plan.seed,
        "draws": sweep.plan.draws,
        "missing": sweep.missing,
        "different": sweep.table.different,
        **{name: one.as_json() for name, one in shares(sweep).items()},
        "dry_runs": {name: one.as_json() for name, one in dry_runs(sweep).items()},
        "cells": [{"values": values, **one.as_json()} for values, one in cells(sweep)],
        "causes": [
            {"verdict": verdict, "cause": cause, "uavs": count}
            for verdict, cause, count in causes(sweep)
        ],
        "figures": figures,
        "worst": [vars(one) for one in worst(sweep)],
    }
