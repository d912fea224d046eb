"""The table of a sweep as arrays: one row for each UAV and flight, and one row for each flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_sim.sweep import SweepError, SweepPlan
from ptnsbc_sim.sweep.chunks import DRAWN
from ptnsbc_sim.sweep.rows import NOT_FLOWN, SweepRow
from ptnsbc_sim.sweep.runner import PLAN, TABLE
from ptnsbc_sim.verdict.deadline import MET, VIOLATED

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
        value = self.value if self.of else None
        return {
            "count": self.count,
            "of": self.of,
            "share": value,
            "low": self.low,
            "high": self.high,
            "wide": self.wide,
        }


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

_ERRORS = ("error_at_deadline_m", "largest_after_m", "largest_after_all_m", "rmse_after_m")
"""Columns in which NaN is an error that is not finite; None is no figure."""


@dataclass(frozen=True)
class Flights:
    """One value (D,) for each flight. An infinite error was not finite, a NaN is no figure."""

    draw: NDArray[np.int64]
    met: NDArray[np.bool_]
    verdict: Column
    check: Column  # accepted | refused, empty without dry runs
    start_error_m: Array  # the largest of its UAVs
    error_at_deadline_m: Array  # the largest
    largest_after_m: Array  # the largest, without excused spans
    largest_after_all_m: Array  # the largest, with excused spans
    deadlock_s: Array  # the longest of its UAVs
    closest_uav_m: Array
    closest_obstacle_m: Array
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
            met=verdict == MET,
            verdict=verdict,
            check=self["check"][self.first],
            start_error_m=self._most("start_error_m"),
            error_at_deadline_m=self._most("error_at_deadline_m"),
            largest_after_m=self._most("largest_after_m"),
            largest_after_all_m=self._most("largest_after_all_m"),
            deadlock_s=self._most("deadlock_s"),
            closest_uav_m=self._most("closest_uav_m", least=True),
            closest_obstacle_m=self._most("closest_obstacle_m", least=True),
            worst=self._worst(),
        )

    def _most(self, name: str, *, least: bool = False) -> Array:
        """The largest or least of the UAVs of each flight; NaN when none has a figure."""
        return (np.fmin if least else np.fmax).reduceat(self[name], self.first)

    def _worst(self) -> NDArray[np.int64]:
        errors = np.nan_to_num(self["largest_after_all_m"], nan=-1.0, posinf=np.inf)
        rank = np.select([self["verdict"] == VIOLATED, self["verdict"] != MET], [2, 1], 0)
        ends = [*self.first[1:], len(self)]
        found = [
            begin + int(np.lexsort((errors[begin:end], rank[begin:end]))[-1])
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
    """The plan of a sweep from its folder.

    Raises:
        SweepError: there is none, or it cannot be read.
    """
    path = folder / PLAN
    try:
        return SweepPlan.from_json(path.read_text(encoding="utf-8"))
    except OSError:
        raise SweepError(f"{folder}: no sweep: expected a folder with {PLAN}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise SweepError(f"{path}: no plan of a sweep: {error}") from None


def read_sweep(folder: Path) -> FlownSweep:
    """A sweep from its folder.

    Raises:
        SweepError: it is none, or it is not complete.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    plan = plan_in(folder)
    path = folder / TABLE
    if not path.is_file():
        raise SweepError(
            f"{folder}: the sweep was ended early: expected {TABLE}; the command that began it continues"
        )
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise SweepError(f"{path}: cannot be read: {error}") from None
    lacking = [field.name for field in fields(SweepRow) if field.name not in table.column_names]
    if lacking:
        raise SweepError(f"{path}: lacks the columns {', '.join(lacking)}: fly the sweep again")
    if not len(table):
        raise SweepError(f"{path}: holds no flight: fly the sweep again")
    lost, table = _divided(table)
    if not len(table):
        raise SweepError(f"{folder}: no draw could be flown: {lost[0][1]}")
    columns = {name: _column(name, table.column(name)) for name in table.column_names}
    return FlownSweep(plan, folder, FlightTable(columns), lost)


def _divided(table: Any) -> tuple[tuple[tuple[int, str], ...], Any]:
    """Draws that were not flown with their causes, and the rows of the others."""
    import pyarrow.compute as pc

    lost = table.filter(pc.equal(table["verdict"], NOT_FLOWN)).select(["draw", "cause"])
    pairs = tuple((row["draw"], row["cause"]) for row in lost.to_pylist())
    return pairs, table.filter(pc.not_equal(table["verdict"], NOT_FLOWN))


def _column(name: str, column: Any) -> Column:
    import pyarrow as pa

    if not pa.types.is_floating(column.type):
        return np.array(column.to_pylist())
    values: Array = np.array(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    if name in _ERRORS:
        values[np.isnan(values) & ~np.asarray(column.is_null())] = np.inf
    return values


def table_of(rows: list[SweepRow]) -> FlightTable:
    """The rows of flights that were not flown by a sweep."""
    columns: dict[str, Column] = {}
    for field, *values in zip(fields(SweepRow), *(astuple(row) for row in rows), strict=True):
        if "float" not in str(field.type):
            columns[field.name] = np.array(values)
            continue
        found = np.array([np.nan if value is None else value for value in values])
        none = np.array([value is None for value in values])
        if field.name in _ERRORS:
            found[np.isnan(found) & ~none] = np.inf
        columns[field.name] = found
    return FlightTable(columns)
