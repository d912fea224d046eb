"""Sweeps: the functions behind `ptnsbc sweep` and `compare`, and their results as arrays and tables."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.sweep.draws import SweepError, parse_axis, parse_starts
from ptnsbc_sim.sweep.family import find_family
from ptnsbc_sim.sweep.plan import SweepPlan, draw, plan_of
from ptnsbc_sim.sweep.rows import fly_draw, rows_of
from ptnsbc_sim.sweep.runner import TABLE, SweepResult, columns_of, run
from ptnsbc_sim.track import refuse_without_memory
from ptnsbc_tools import console, ros
from ptnsbc_tools.library.flight import Flight, new_axes
from ptnsbc_tools.library.flying import ScenarioLike, fly, load
from ptnsbc_tools.limits import LARGEST_SEED, MOST_RUNS, path_of, refuse_outside
from ptnsbc_tools.sweeps import comparison, summary
from ptnsbc_tools.sweeps.comparison import SweepComparison
from ptnsbc_tools.sweeps.summary import Column, FlightTable, FlownSweep, Share, read_sweep, table_of
from ptnsbc_tools.tables import Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOMENT_S = 0.05


@dataclass(frozen=True, repr=False)
class Sweep:
    """A sweep that was flown: shares with intervals, and one row of figures for each UAV and flight."""

    flown: FlownSweep

    @property
    def plan(self) -> SweepPlan:
        """The plan of the flights."""
        return self.flown.plan

    @property
    def met(self) -> Share:
        """Flights whose UAVs all met the deadline and kept their distances, with the Wilson interval."""
        return summary.flights_met(self.flown)

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """The columns (R,) of the table by name; docs/sweeps.md says what they mean."""
        return self.flown.table.columns

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column; empty for words and numbers without one."""
        return {name: unit for name, _, unit in columns_of(self.plan) if name in self.columns}

    @property
    def summary(self) -> Summary:
        """The shares of flights and UAVs that met and were in place, with their Wilson intervals."""
        return summary.summary_of(self.flown)

    def __getitem__(self, name: str) -> Column:
        """A column (R,) by its name."""
        if name not in self.columns:
            raise SweepError(f"{name}: no column of the sweep: {similar(name, self.columns)}")
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.flown.table.flights.draw)

    def scenario(self, k: int) -> Scenario:
        """The scenario of draw k."""
        return draw(self.plan, k)

    def fly(self, k: int, *, progress: bool | None = None) -> Flight:
        """Fly draw k again: the same flight, bit for bit."""
        return fly(self.scenario(k), checked=False, progress=progress)

    def to_pandas(self) -> Any:
        """One row for each UAV and flight as a pandas DataFrame; `attrs["units"]` has the units."""
        frame = ros.library("pandas", "to_pandas()").DataFrame(dict(self.columns))
        frame.attrs = {"units": self.units, "plan": self.plan.name}
        return frame

    def plot_met(self, key: str | None = None, axes: Axes | None = None) -> Axes:
        """Draw the share of flights met against a drawn key on Matplotlib axes, and return them.

        By default that is the first key, or the largest start error, on new axes. SweepError when nothing of this name
        was drawn, or all draws have the same value.
        """
        from ptnsbc_tools.sweeps.sweep_report import draw_against, drawn_axes

        found = {one.name.partition(" [")[0]: one for one in drawn_axes(self.flown)}
        name = next(iter(found), "") if key is None else key
        if name not in found:
            raise SweepError(f"{name or 'plot_met'}: the same in all draws: {similar(name, found)}")
        axes = new_axes() if axes is None else axes
        draw_against(axes, self.flown, found[name])
        return axes

    def __repr__(self) -> str:
        return f"<Sweep {self.plan.name}: flights met {self.met}>"


def plan(
    scenario: Scenario,
    runs: int = 200,
    *,
    vary: Mapping[str, str] | Sequence[str] = (),
    starts: str = "file",
    family: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    name: str | None = None,
    **rest: Any,
) -> SweepPlan:
    """The flights of a sweep; the arguments are those of `sweep`, `rest` are further fields of SweepPlan."""
    refuse_outside("runs", runs or 0, 1, MOST_RUNS)
    if isinstance(vary, Mapping):
        vary = [f"{key}={values}" for key, values in vary.items()]
    text = ""
    if family is not None:
        path = find_family(family)
        text, name = path.read_text(encoding="utf-8"), name or path.stem
        tree = reader.parse(text, str(path))
        kept = {key: tree[key] for key in tree if f"formation.{key}" not in (overrides or {})}
        text = text if len(kept) == len(tree) else reader.dump(kept)
    axes = tuple(parse_axis(axis) for axis in vary)
    rest |= {"starts": parse_starts(starts), "family": text, "name": name or scenario.name}
    return plan_of(scenario, runs, axes=axes, **rest)


def fly_plan(
    plan: SweepPlan,
    folder: Path,
    *,
    workers: int | None = None,
    progress: bool | None = True,
    count: Callable[[int], None] = lambda done: None,
) -> SweepResult:
    """Fly what is missing of a plan into a folder; `count` gets the flights that are done.

    SweepError when the folder holds something else, or no draw could be flown; ScenarioError when a flight does not fit
    into memory. After KeyboardInterrupt the next call goes on.
    """
    with suppress(SweepError):  # a draw that cannot be flown is named later
        refuse_without_memory(draw(plan, 0))
    if not (folder / TABLE).exists():
        # The sweep's own progress would stand still for a minute.
        with console.compiling(), suppress(PtnsbcError):
            fly_draw(replace(plan, stop_after_s=_MOMENT_S), 0)
    with console.progress("flying", progress) as advance:

        def on_progress(done: int, total: int) -> None:
            count(done)
            advance(done, total)

        flown = run(plan, folder, workers=workers, progress=on_progress)
    if sum(len(one.draws) for one in flown.failed) == plan.draws:
        raise SweepError(f"no draw could be flown: {flown.failed[0].error}")
    return flown


def sweep(
    scenario: ScenarioLike,
    runs: int = 200,
    *,
    vary: Mapping[str, str] | Sequence[str] = (),
    starts: str = "file",
    family: str | Path | None = None,
    seed: int = 0,
    stop_after_s: float | None = None,
    dry_runs: int = 0,
    folder: str | Path | None = None,
    workers: int | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Fly many draws of a scenario, as `ptnsbc sweep`; the same arguments give the same table.

    Args:
        scenario: what is drawn from.
        runs: flights; of each cell when lists or grids are varied.
        vary: values by dotted key as `--vary` takes them: "LO:HI", "MEAN±SIGMA", "LO:HI:COUNT", "A,B,C".
        starts: "file", "near:SIGMA" or "box:X,Y,Z", in metres.
        family: draw whole scenarios from this family, by name or file.
        seed: of all draws.
        stop_after_s: end every flight at this time.
        dry_runs: perturbed flights of the dry run before each flight.
        folder: keep the sweep there, and go on with what is there; by default nothing is kept.
        workers: processes, by default one for each core; 1: this process.

    Raises:
        LimitError: fewer than one or more than a million `runs`.
        SweepError: a draw that cannot be, another sweep in the folder, or no draw could be flown.
    """
    refuse_outside("seed", seed, 0, LARGEST_SEED)
    refuse_outside("stop_after_s", stop_after_s)
    refuse_outside("dry_runs", dry_runs, 0, MOST_RUNS)
    refuse_outside("workers", workers, 1, MOST_RUNS)
    flown = plan(
        load(scenario),
        runs,
        vary=vary,
        starts=starts,
        family=family,
        seed=seed,
        stop_after_s=stop_after_s,
        check=dry_runs,
    )
    with tempfile.TemporaryDirectory(prefix="ptnsbc-") as temporary:
        place = Path(temporary) / "sweep" if folder is None else path_of("folder", folder)
        fly_plan(flown, place, workers=workers, progress=progress)
        return Sweep(read_sweep(place))


def open_sweep(folder: str | Path, *, strict: bool = False) -> Sweep:
    """A sweep from its folder, as `ptnsbc sweep` wrote it; SweepError when it is none, or not complete.

    `strict`: UAVs that gave way and came late have missed.
    """
    return Sweep(read_sweep(path_of("folder", folder), strict=strict))


def compare(
    a: Sweep | Flight,
    *others: Sweep | Flight,
    names: Sequence[str] = "BCDEFGHIJKLMNOPQRSTUVWXYZ",
    margin_m: float = 0.001,
    seed: int = 0,
) -> SweepComparison:
    """Compare others with A: the share that was met and the errors, paired by draw, with intervals.

    With several of them the intervals hold together (Bonferroni), and the p values are corrected by Holm's method.

    Args:
        a: a sweep, or a flight.
        others: other ones of the same draws, or other flights.
        names: of the others.
        margin_m: an error that grew by less is not worse.
        seed: of the bootstrap.

    Raises:
        ComparisonError: the sweeps draw differently, a flight beside a sweep, or a bag that lacks a UAV.
    """
    refuse_outside("margin_m", margin_m)
    refuse_outside("seed", seed, 0, LARGEST_SEED)
    if not 0 < len(others) <= len(set(names)):
        raise comparison.ComparisonError(
            f"{len(others)} others: expected one or more, with as many names"
        )
    plans = [one.plan for one in (a, *others) if isinstance(one, Sweep)]
    flights = sum(isinstance(one, Flight) for one in (a, *others))
    if 1 + len(others) not in (len(plans), flights):
        raise comparison.ComparisonError("a sweep and a flight: expected sweeps, or flights")
    for other in plans[1:]:
        comparison.same_draws(plans[0], other)
    tables = {name: _table_of(one) for name, one in zip(names, others, strict=False)}
    return comparison.compare(_table_of(a), tables, margin_m=margin_m, seed=seed)


def _table_of(one: Sweep | Flight) -> FlightTable:
    if isinstance(one, Sweep):
        return one.flown.table
    for uav in one.uavs:
        if uav not in one.recording.counters:
            raise comparison.ComparisonError(
                f"{one.bag or one.scenario.name}: /diagnostics lacks UAV {uav}: expected a whole flight"
            )
    return table_of(rows_of(0, one.scenario, one.recording))
