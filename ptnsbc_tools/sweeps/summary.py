"""The result of a sweep: shares, causes, errors and the worst flights, as tables and as JSON."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table
from rich.text import Text

from ptnsbc_core.types import Array
from ptnsbc_sim.sweep import SweepAxis
from ptnsbc_sim.sweep.draws import NORMAL, UNIFORM, VALUES
from ptnsbc_sim.sweep.dry_run import ACCEPTED, REFUSED
from ptnsbc_sim.verdict.deadline import MET, VIOLATED
from ptnsbc_tools.sweeps.table import FlownSweep, Share, share_of
from ptnsbc_tools.tables import word

_WORST = 5
_MOST_CELLS = 40
_UAV = re.compile(r"\b(uav|UAV )\d+")
_NUMBER = re.compile(r"(?<![A-Za-z])\d+(?:\.\d+)?(?:e[-+]?\d+)?")

_UPWARD = (
    ("settled", "settling_s", "s"),
    ("error at tf", "error_at_deadline_m", "m"),
    ("largest after tf, without excused spans", "largest_after_m", "m"),
    ("largest after tf, with excused spans", "largest_after_all_m", "m"),
    ("RMSE after tf, without excused spans", "rmse_after_m", "m"),
    ("outside the band after tf, excused", "excused_outside_s", "s"),
    ("back in place after an encounter", "regained_s", "s"),
    ("promised for it", "recovery_s", "s"),
    ("saturated until tf", "saturated_s", "s"),
    ("peak force", "peak_force_n", "N"),
    ("energy (54)", "energy_n2_s", "N^2 s"),
)
_DOWNWARD = (
    ("closest pair of UAVs", "closest_uav_m"),
    ("room to the closest obstacle", "closest_obstacle_m"),
)


@dataclass(frozen=True)
class WorstFlight:
    """A flight to look at, and the command that flies it again."""

    draw: int
    uav: int
    verdict: str
    cause: str
    largest_after_m: float | None
    largest_after_all_m: float | None
    closest_uav_m: float | None
    command: str


_WORDS = ("", "cause", "unit", "all UAVs", "each flight", "95 % interval")
"""Headings of the columns that hold no numbers."""


def new_table(title: str, heads: tuple[str, ...], words: tuple[str, ...] = _WORDS) -> Table:
    """A table without rows; all columns but `words` are numbers."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for head in heads:
        table.add_column(head, justify="left" if head in words else "right", overflow="fold")
    return table


def again(sweep: FlownSweep, draw: int) -> str:
    """The command that flies one draw again."""
    return shlex.join(["ptnsbc", "simulate", "--sweep", str(sweep.folder), "--draw", str(draw)])


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
    """The flights to look at: inside a keep-out first, then not met, then the largest error after tf."""
    flights, table = sweep.table.flights, sweep.table
    errors = np.nan_to_num(flights.largest_after_all_m, nan=-1.0, posinf=np.inf)
    inside = flights.verdict == VIOLATED
    order = np.lexsort((flights.draw, -errors, flights.met, ~inside))[:count]
    return [
        WorstFlight(
            draw=int(flights.draw[k]),
            uav=int(table["uav"][flights.worst[k]]),
            verdict=str(flights.verdict[k]),
            cause=str(table["cause"][flights.worst[k]]),
            largest_after_m=number(flights.largest_after_m[k]),
            largest_after_all_m=number(flights.largest_after_all_m[k]),
            closest_uav_m=number(flights.closest_uav_m[k]),
            command=again(sweep, int(flights.draw[k])),
        )
        for k in order
    ]


class Quantiles(NamedTuple):
    """Three values of a figure over UAVs or flights, below which shares of them lie; none is interpolated."""

    label: str
    name: str
    unit: str
    having: int  # UAVs or flights that have it
    values: tuple[float, ...]


def _quantiles(
    label: str, name: str, unit: str, values: Array, shares: tuple[float, ...]
) -> Iterator[Quantiles]:
    """The quantiles of a figure; nothing where no UAV or flight has it."""
    kept = np.sort(values[~np.isnan(values)])
    if len(kept):
        places = (min(int(share * len(kept)), len(kept) - 1) for share in shares)
        yield Quantiles(label, name, unit, len(kept), tuple(float(kept[k]) for k in places))


def _upward(sweep: FlownSweep) -> Iterator[Quantiles]:
    """Median, 95 % and largest of errors and effort, over UAVs."""
    for label, name, unit in _UPWARD:
        yield from _quantiles(label, name, unit, sweep.table[name], (0.5, 0.95, 1.0))


def _downward(sweep: FlownSweep) -> Iterator[Quantiles]:
    """Least, 1 % and median of distances, over flights."""
    for label, name in _DOWNWARD:
        values = getattr(sweep.table.flights, name)
        yield from _quantiles(label, name, "m", values, (0.0, 0.01, 0.5))


def flights_met(sweep: FlownSweep) -> Share:
    """Flights whose UAVs all met the deadline and kept their distances."""
    return share_of(sweep.table.flights.met)


def uavs_met(sweep: FlownSweep) -> Share:
    """UAVs that met the deadline and kept their distances; those of one flight are not independent."""
    return share_of(sweep.table["verdict"] == MET)


def inside_keep_out(sweep: FlownSweep) -> Share:
    """Flights in which a UAV was inside the keep-out of another UAV or of an obstacle."""
    return share_of(sweep.table.flights.verdict == VIOLATED)


def deadlocks(sweep: FlownSweep) -> Share:
    """Flights in which avoidance left a UAV no way to its place for `gains.clearance.deadlock_s`."""
    return share_of(sweep.table.flights.deadlock_s > 0.0)


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
            values = {axis.key: drawn[axis.key][inside[0]] for axis in plan.grid}
            found.append((values, share_of(flights.met[inside])))
    return found


def _share_table(sweep: FlownSweep) -> Table:
    table = new_table(title(sweep), ("", "count", "of", "share", "95 % interval", ""))
    shares = {
        "flights met": flights_met(sweep),
        "UAVs met": uavs_met(sweep),
        "flights inside a keep-out": inside_keep_out(sweep),
        "flights with a deadlock": deadlocks(sweep),
        **dry_runs(sweep),
    }
    for name, one in shares.items():
        wide = "wide: fly more" if one.wide else ""
        table.add_row(name, *_share_cells(one), wide)
    return table


def _share_cells(one: Share) -> tuple[str, str, str, str]:
    value = f"{100 * one.value:.1f} %" if one.of else "-"
    return str(one.count), str(one.of), value, one.interval


def axis_text(axis: SweepAxis) -> str:
    """An axis as `--vary` takes it."""
    between = {UNIFORM: ":", NORMAL: "±", VALUES: ","}[axis.kind]
    shown = (f"{value:g}" if isinstance(value, float) else str(value) for value in axis.values)
    return f"{axis.key}={between.join(shown)}"


def title(sweep: FlownSweep) -> str:
    """The flights of a sweep, in a line."""
    plan = sweep.plan
    drawn = [axis_text(axis) for axis in plan.axes]
    if plan.starts.kind != "file":
        numbers = ",".join(f"{value:g}" for value in plan.starts.numbers)
        drawn.append(f"starts {plan.starts.kind}:{numbers}")
    varied = f"; {', '.join(drawn)}" if drawn else ""
    return f"{plan.name}: {plan.draws} flights, seed {plan.seed}{varied}"


def _cells_table(sweep: FlownSweep) -> Table | None:
    found = cells(sweep)
    if not found:
        return None
    keys = [axis.key for axis in sweep.plan.grid]
    heads = (*keys, "met", "of", "share", "95 % interval", "")
    table = new_table("Flights of each cell of the grid", heads)
    for values, one in found[:_MOST_CELLS]:
        shown = [
            f"{values[key]:g}" if isinstance(values[key], float) else str(values[key])
            for key in keys
        ]
        table.add_row(*shown, *_share_cells(one), "wide" if one.wide else "")
    if len(found) > _MOST_CELLS:
        table.caption = f"{len(found) - _MOST_CELLS} more cells: --json, or the table"
    return table


def _digits(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e5 else f"{value:.2e}"


def tables(sweep: FlownSweep) -> list[Table]:
    """All tables, in the order in which they are read; those without rows are left out."""
    why = new_table("Why UAVs are not met", ("", "UAVs", "cause"))
    for verdict, cause, count in causes(sweep):
        why.add_row(word(verdict), str(count), cause)
    figures = new_table(
        "Errors and effort", ("all UAVs", "unit", "UAVs", "median", "95 %", "largest")
    )
    for of in _upward(sweep):
        figures.add_row(of.label, of.unit, str(of.having), *map(_digits, of.values))
    distances = new_table("Distances", ("each flight", "unit", "flights", "least", "1 %", "median"))
    for of in _downward(sweep):
        style = "bold red" if of.values[0] < 0.0 else ""
        distances.add_row(of.label, of.unit, str(of.having), *map(_digits, of.values), style=style)
    heads = ("draw", "", "UAV", "largest after m", "with excused m", "closest UAV m", "cause")
    look_at = new_table("The flights to look at", heads)
    for flight in worst(sweep):
        values = (flight.largest_after_m, flight.largest_after_all_m, flight.closest_uav_m)
        shown = ["-" if value is None else _digits(value) for value in values]
        look_at.add_row(
            str(flight.draw), word(flight.verdict), str(flight.uav), *shown, flight.cause
        )
    every = (_share_table(sweep), _cells_table(sweep), why, figures, distances, look_at)
    return [table for table in every if table is not None and (table.row_count or table is figures)]


def line(sweep: FlownSweep) -> Text:
    """The last line: the share of flights in a sentence."""
    flown = flights_met(sweep)
    text = Text(f"Flights met: {flown}")
    if sweep.table.different < flown.of:
        text.append(
            f"; only {sweep.table.different} of them differ: vary the starts or a range", "bold red"
        )
    if sweep.missing:
        text.append(f"; {sweep.missing} of {sweep.plan.draws} draws were not flown", "bold red")
    return text


def as_json(sweep: FlownSweep) -> dict[str, Any]:
    """The summary as plain data."""
    names = {_upward: ("median", "p95", "max"), _downward: ("min", "p1", "median")}
    figures = {
        of.name: {"unit": of.unit, **dict(zip(keys, map(number, of.values), strict=True))}
        for quantiles, keys in names.items()
        for of in quantiles(sweep)
    }
    return {
        "name": sweep.plan.name,
        "seed": sweep.plan.seed,
        "draws": sweep.plan.draws,
        "missing": sweep.missing,
        "different": sweep.table.different,
        "flights": flights_met(sweep).as_json(),
        "uavs": uavs_met(sweep).as_json(),
        "inside_keep_out": inside_keep_out(sweep).as_json(),
        "deadlocks": deadlocks(sweep).as_json(),
        "dry_runs": {name: one.as_json() for name, one in dry_runs(sweep).items()},
        "cells": [
            {
                "values": {
                    k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()
                },
                **one.as_json(),
            }
            for values, one in cells(sweep)
        ],
        "causes": [
            {"verdict": verdict, "cause": cause, "uavs": count}
            for verdict, cause, count in causes(sweep)
        ],
        "figures": figures,
        "worst": [vars(one) for one in worst(sweep)],
    }
