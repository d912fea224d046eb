"""`ptnsbc sweep`: hundreds of flights of a scenario or a family, and the share that met the deadline."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options
from ptnsbc_tools.limits import LONGEST_S, MOST_RUNS

if TYPE_CHECKING:
    from ptnsbc_sim.sweep import SweepPlan, SweepResult
    from ptnsbc_tools.sweeps.table import FlownSweep

_BASE = "paper_5_free"
_LACKING, _INTERRUPTED = 1, 130
_MOST_NAMED = 5
_MADE = ("plan.json", "table.parquet", "chunks", "report")


def _print_families(wanted: bool) -> None:
    if not wanted:
        return
    from ptnsbc_sim.sweep.family import families, family_from_text, find_family

    for name in families():
        path = find_family(name)
        try:
            described = family_from_text(path.read_text(encoding="utf-8"), str(path)).description
        except PtnsbcError as error:
            described = f"not in this version: {error}"
        print(f"{name:12} {described}")
    raise typer.Exit


def sweep(
    context: typer.Context,
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENARIO]",
            help=f"A scenario file, or a name. With --family: the vehicle and gains, by default {_BASE}.",
        ),
    ] = None,
    runs: Annotated[
        int,
        typer.Option(
            "--runs",
            "-n",
            metavar="N",
            min=1,
            max=MOST_RUNS,
            help="Flights; of each cell when lists or grids are varied.",
        ),
    ] = 200,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=VALUES",
            help="A dotted key and LO:HI (uniform), MEAN±SIGMA or MEAN+-SIGMA (normal), LO:HI:COUNT (grid) "
            "or A,B,C (list). Repeatable: lists and grids make all combinations.",
        ),
    ] = None,
    latin: Annotated[
        bool, typer.Option("--latin", help="Draw the ranges from one Latin hypercube.")
    ] = False,
    starts: Annotated[
        str,
        typer.Option(
            "--starts",
            metavar="WHERE",
            help="Starts: file, near:SIGMA (beside those of the file) or box:X,Y,Z (anywhere in it), in metres.",
        ),
    ] = "file",
    family: Annotated[
        str | None,
        typer.Option(
            "--family",
            metavar="FILE",
            help="Draw whole scenarios from a family: its file, or a name that --list-families prints.",
        ),
    ] = None,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    settings: options.SetOption = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of all draws.")] = 0,
    stop_after: Annotated[
        float | None,
        typer.Option(
            "--stop-after",
            metavar="S",
            min=0.01,
            max=LONGEST_S,
            help="End every flight at this time.",
        ),
    ] = None,
    check: Annotated[
        int,
        typer.Option(
            "--check",
            metavar="N",
            min=0,
            max=MOST_RUNS,
            help="Before each flight a dry run with N perturbed flights accepts or refuses it; flown it is anyway.",
        ),
    ] = 0,
    name: Annotated[
        str | None,
        typer.Option("--name", metavar="NAME", help="Default: that of the scenario or the family."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Folder. Default: out/sweeps/NAME."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", "-j", metavar="N", min=1, max=256, help="Processes. Default: one per core."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler", metavar="ADDRESS", help="Fly on the workers of this Dask cluster."
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="Write a page and figures into DIR/report.")
    ] = True,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Replace a sweep of another plan, or of other laws, in DIR."
        ),
    ] = False,
    json: options.JsonOption = False,
    list_families: Annotated[
        bool,
        typer.Option(
            "--list-families",
            callback=_print_families,
            is_eager=True,
            help="Print the families that can be given by name.",
        ),
    ] = False,
) -> None:
    """Fly many draws of a scenario: the share that meets the deadline, with its interval.

    A sweep that was ended early goes on where it ended: give the same command again. Exit code 0: all
    draws were flown, whatever their verdicts are. 1: some draws could not be flown; they are named.
    """
    plan = _plan(context.params)
    folder = out or options.SWEEPS / plan.name
    _clear(folder, plan, overwrite=overwrite)
    flown = _fly(plan, folder, workers, scheduler)

    from ptnsbc_tools.sweeps import summary
    from ptnsbc_tools.sweeps.table import read_sweep

    found = read_sweep(folder)
    page = _write_report(found) if report else None
    if json:
        files = {"table": str(flown.table), "report": str(page) if page else None}
        failed = [
            {"first": one.draws.start, "last": one.draws[-1], "error": one.error}
            for one in flown.failed
        ] + [{"first": k, "last": k, "error": cause} for k, cause in found.not_flown]
        console.print_json({**summary.as_json(found), "failed": failed, **files})
    else:
        _show(found, flown, page)
    if found.missing:
        raise typer.Exit(_LACKING)


def _plan(given: dict[str, Any]) -> SweepPlan:
    from ptnsbc_sim.sweep import SweepError
    from ptnsbc_tools.library import sweeping

    if given["scenario"] is None and given["family"] is None:
        raise SweepError("expected a SCENARIO or --family")
    if given["scheduler"] is not None and given["workers"] is not None:
        raise SweepError("--scheduler: the cluster has its own workers: leave out --workers")
    own = {key: value for key, value in given.items() if key != "seed"}  # it is that of the draws
    overrides = options.overrides(**own)
    return sweeping.plan(
        options.scenario_with(given["scenario"] or _BASE, overrides),
        given["runs"],
        vary=given["vary"] or (),
        latin=given["latin"],
        starts=given["starts"],
        family=given["family"],
        overrides=overrides,
        seed=given["seed"],
        stop_after_s=given["stop_after"],
        dry_runs=given["check"],
        name=given["name"],
    )


def _clear(folder: Path, plan: SweepPlan, *, overwrite: bool) -> None:
    """Remove a sweep of another plan or of other laws; other files in the folder stay, and have it refused."""
    from ptnsbc_sim.sweep import SweepError
    from ptnsbc_sim.sweep.runner import flown_by_others

    path = folder / _MADE[0]
    if not path.is_file():
        return
    if path.read_text(encoding="utf-8") != plan.to_json():
        other = "a sweep of another plan"
    elif flown_by_others(folder, plan):
        other = "flights of other laws or library versions"
    else:
        return
    if not overwrite:
        raise SweepError(f"{folder}: holds {other}: choose another --output, or --overwrite")
    for name in _MADE:
        made = folder / name
        if made.is_dir():
            shutil.rmtree(made)
        else:
            made.unlink(missing_ok=True)


def _fly(plan: SweepPlan, folder: Path, workers: int | None, scheduler: str | None) -> SweepResult:
    from ptnsbc_sim.sweep import SweepError
    from ptnsbc_tools.library.sweeping import fly_plan

    done = [0]
    try:
        return fly_plan(plan, folder, workers=workers, scheduler=scheduler, count=done.append)
    except KeyboardInterrupt:
        console.say(
            f"interrupted: {done[-1]} of {plan.draws} flights are kept in {folder}; "
            "the same command goes on from there"
        )
        raise typer.Exit(_INTERRUPTED) from None
    except OSError as error:
        what = f"scheduler {scheduler}" if scheduler is not None else str(folder)
        raise SweepError(f"{what}: {error}") from error


def _write_report(found: FlownSweep) -> Path:
    from ptnsbc_tools.sweeps.page import write_report

    with console.patience("drawing"):
        return write_report(found)


def _show(found: FlownSweep, flown: SweepResult, page: Path | None) -> None:
    from ptnsbc_tools.sweeps import summary

    out = console.out()
    for table in summary.tables(found):
        out.print(table)
    for one in summary.worst(found):
        print(f"fly draw {one.draw} again: {one.command}")
    for failed in flown.failed:
        first, last = failed.draws.start, failed.draws[-1]
        print(f"draws {first} to {last} were not flown: {failed.error}", file=sys.stderr)
    for draw, cause in found.not_flown[:_MOST_NAMED]:
        print(f"draw {draw} was not flown: {cause}", file=sys.stderr)
    if len(found.not_flown) > _MOST_NAMED:
        rest = len(found.not_flown) - _MOST_NAMED
        print(f"{rest} more were not flown: their causes are in the table", file=sys.stderr)
    out.print(summary.line(found), soft_wrap=True)
    print(f"table: {flown.table}")
    if page is not None:
        print(f"report: {page}")
