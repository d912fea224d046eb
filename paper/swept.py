"""Sweeps of the experiments: what is drawn and flown, and tables of shares with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from paper.experiment_result import Cell, Column, Table
from paper.flights import Setting, scenario
from paper.output import ExperimentFolder
from ptnsbc_core.types import Array
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_sim.sweep.runner import run
from ptnsbc_sim.verdict.deadline import KEPT, VIOLATED
from ptnsbc_tools.sweeps.summary import FlightTable, FlownSweep, Share, read_sweep, share_of

RUNS = 200
DEFAULT_APPROACH: Setting = {"formation.approach": None, "gains.clearance.approach": None}
"""The scenario's own ways to the formation and past objects, where experiments fly the paper's."""


@dataclass(frozen=True)
class SweepCase:
    """One sweep: a scenario with changed keys, and how its flights are drawn."""

    labels: tuple[str, ...]  # its name, and the first cells of its row
    scenario: str = "paper_5_free"
    changes: Setting = field(default_factory=dict)
    starts: str = "near:0.3"
    family: str = ""  # text
    stop_after_s: float | None = 10.0
    runs: int = RUNS


def fly_case(output: ExperimentFolder, name: str, case: SweepCase) -> FlownSweep:
    """Fly a sweep into the folder `sweeps/<name>`, from which `ptnsbc simulate --sweep` flies each draw again."""
    what = ", ".join((name, *case.labels))
    output.progress(f"sweeping {what}")
    slug = "-".join(name for name in "".join(c if c.isalnum() else " " for c in what).split())
    plan = plan_of(
        scenario(case.scenario, case.changes),
        case.runs,
        starts=parse_starts(case.starts),
        family=case.family,
        stop_after_s=case.stop_after_s,
        name=what,
    )
    folder = output.folder / "sweeps" / slug
    run(plan, folder, workers=1)
    return read_sweep(folder)


def met(table: FlightTable) -> Share:
    """Flights whose UAVs all met the deadline and kept their distances."""
    return share_of(table.flights.met)


def _quantile(values: Array, share: float) -> float | None:
    """The value below which this share lies; None when nobody has one, or it is not finite."""
    kept = np.sort(values[~np.isnan(values)])
    if not len(kept):
        return None
    found = float(kept[min(int(share * len(kept)), len(kept) - 1)])
    return found if np.isfinite(found) else None


_COLUMNS = (
    Column("flights met"),
    Column("share"),
    Column("95 % interval"),
    Column("UAVs met, %", 1),
    Column("error at tf, median, m", 4),
    Column("largest after tf, 95 %, m", 4),
    Column("the same with excused spans, m", 4),
    Column("closest pair, least, m", 2),
    Column("flights inside a keep-out"),
)


def _cells(table: FlightTable) -> tuple[Cell, ...]:
    flights, kept = table.flights, met(table)
    closest = table.of_flights("closest_uav_m")
    closest = closest[~np.isnan(closest)]
    return (
        f"{kept.count} of {kept.of}",
        f"{100 * kept.value:.1f} %",
        kept.interval + (", wide" if kept.wide else ""),
        100.0 * float(np.mean(np.isin(table["verdict"], KEPT))),
        _quantile(table.of_flights("error_at_deadline_m"), 0.5),
        _quantile(table.of_flights("largest_after_m"), 0.95),
        _quantile(table.of_flights("largest_after_all_m"), 0.95),
        float(closest.min()) if len(closest) else None,
        str(share_of(flights.verdict == VIOLATED)),
    )


def shares_table(
    name: str,
    title: str,
    heads: Sequence[str],
    rows: Iterable[tuple[tuple[str, ...], FlightTable]],
    meaning: str = "",
) -> Table:
    """A row for each sweep, by its labels: its share of flights met, its errors and its distances."""
    columns = (*(Column(head) for head in heads), *_COLUMNS)
    return Table(
        name, title, columns, tuple((*some, *_cells(table)) for some, table in rows), meaning
    )


def swept_table(
    output: ExperimentFolder,
    name: str,
    title: str,
    heads: Sequence[str],
    cases: Iterable[SweepCase],
    meaning: str = "",
) -> Table:
    """Fly the cases, and make a table of them."""
    rows = ((case.labels, fly_case(output, name, case).table) for case in cases)
    return shares_table(name, title, heads, rows, meaning)
