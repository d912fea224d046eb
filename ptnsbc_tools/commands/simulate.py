"""Flights in this process: one of `ptnsbc simulate`, many of `ptnsbc sweep`, and `ptnsbc compare` of two."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.commands.check import preflight
from ptnsbc_tools.limits import FARTHEST_M, LONGEST_S, MOST_RUNS
from ptnsbc_tools.options import (
    SWEEPS,
    BagOption,
    Choices,
    FlightChoices,
    JsonOption,
    OverwriteOption,
    PictureOption,
    Showing,
    StrictOption,
    VerboseOption,
    argument,
    option,
    scenario_with,
)

if TYPE_CHECKING:
    from ptnsbc_sim.sweep.plan import SweepPlan
    from ptnsbc_sim.sweep.runner import SweepResult
    from ptnsbc_sim.sweep.search import Found
    from ptnsbc_tools.sweeps.summary import FlownSweep

_BASE = "paper_5_free"
_LACKING, _WORSE, _INTERRUPTED = 1, 1, 130
_MOST_NAMED = 5
_MADE = ("plan.json", "table.parquet", "chunks", "report")


def simulate(
    choices: FlightChoices,
    scenario: Annotated[
        str | None,
        argument(
            "[SCENARIO]", "A scenario file, or a name such as paper_5; or --sweep and --draw."
        ),
    ] = None,
    sweep: Annotated[
        Path | None, option("--sweep DIR", "Fly a draw of the sweep in this folder.")
    ] = None,
    draw: Annotated[int | None, option("--draw K", "The draw to fly; with --sweep.", 0)] = None,
    picture: PictureOption = None,
    bag: BagOption = None,
    overwrite: OverwriteOption = False,
    *,
    showing: Showing,
) -> None:
    """Fly a scenario in this process, without ROS, and judge it."""
    from ptnsbc_sim.track import refuse_without_memory
    from ptnsbc_tools.library.flying import fly
    from ptnsbc_tools.plotting.draw import format_of
    from ptnsbc_tools.reading.headless import prepare_bag
    from ptnsbc_tools.tables import show_verdict

    if sweep is None and draw is None and scenario is not None:
        chosen = choices.of(scenario)
    else:
        from ptnsbc_sim.scenario import scenario_from_text
        from ptnsbc_sim.sweep.draws import SweepError
        from ptnsbc_sim.sweep.plan import draw as draw_of
        from ptnsbc_tools.sweeps.summary import plan_in

        if scenario is not None or sweep is None or draw is None:
            raise SweepError("expected a SCENARIO, or --sweep DIR and --draw K")
        chosen, keys = draw_of(plan_in(sweep), draw), choices.keys()
        if keys:
            chosen = scenario_from_text(chosen.text, keys, source=chosen.source)
        chosen = choices.paced(chosen)
    if picture is not None:
        format_of(picture)  # refused before the flight, not after it
    refuse_without_memory(chosen)  # the check of a flight of ages takes ages
    preflight(chosen, quiet=showing.json, refusing=sweep is None)
    if bag is not None:
        prepare_bag(bag, overwrite=overwrite)

    flight = fly(chosen, checked=False, progress=True)
    if bag is not None:
        with console.progress("recording") as advance:
            bag = flight.save(bag, overwrite=overwrite, progress=advance).bag
    if picture is not None:
        flight.save_picture(picture)
    code = show_verdict(flight.verdict, showing, bag=bag, picture=picture)
    if bag is None and not showing.json:
        place = Path("out", chosen.name)
        console.show(f"next: the same with --bag {place}, then {console.program()} report {place}")
    raise typer.Exit(code)


def _print_families() -> None:
    from ptnsbc_sim.sweep.family import families, family_from_text, find_family

    for name in families():
        path = find_family(name)
        try:
            described = family_from_text(path.read_text(encoding="utf-8"), str(path)).description
        except PtnsbcError as error:
            described = f"not in this version: {error}"
        print(f"{name:12} {described}")


@dataclass(frozen=True)
class Draws(Choices):
    """Options of the draws."""

    runs: Annotated[
        int,
        option(
            "--runs -n N", "Flights; of each cell when lists or grids are varied.", 1, MOST_RUNS
        ),
    ] = 200
    vary: Annotated[
        list[str] | None,
        option(
            "--vary KEY=VALUES",
            "A dotted key and LO:HI (uniform), MEAN±SIGMA or MEAN+-SIGMA (normal), LO:HI:COUNT (grid) "
            "or A,B,C (list). Repeatable: lists and grids make all combinations.",
        ),
    ] = None
    starts: Annotated[
        str,
        option(
            "--starts WHERE",
            "Starts: file, near:SIGMA (beside those of the file) or box:X,Y,Z (anywhere in it), in metres.",
        ),
    ] = "file"
    family: Annotated[
        str | None,
        option(
            "--family FILE",
            "Draw whole scenarios from a family: its file, or a name that --list-families prints.",
        ),
    ] = None
    draw_seed: Annotated[int, option("--seed N", "Seed of all draws.", 0)] = 0
    stop_after: Annotated[
        float | None, option("--stop-after S", "End every flight at this time.", 0.01, LONGEST_S)
    ] = None
    check: Annotated[
        int,
        option(
            "--check N",
            "Before each flight a dry run with N perturbed flights accepts or refuses it; flown it is anyway.",
            0,
            MOST_RUNS,
        ),
    ] = 0
    search: Annotated[
        Literal["worst"] | None,
        option(
            "--search worst",
            "Draw by a search for broken promises, with --runs flights; the worst of them are the sweep.",
        ),
    ] = None
    rare: Annotated[
        float | None,
        option(
            "--rare P",
            "Search for the probability of a broken promise, down to P; the worst flights are the sweep.",
            1e-9,
            0.5,
        ),
    ] = None
    promise: Annotated[
        Literal["keep_out", "deadline", "return"] | None,
        option("--promise WHICH", "Search for this promise alone, by default the worst flights."),
    ] = None
    name: Annotated[
        str | None, option("--name NAME", "Default: that of the scenario or the family.")
    ] = None

    def plan(self, scenario: str | None) -> SweepPlan:
        """The flights of a scenario, or of the family."""
        from ptnsbc_sim.sweep.draws import SweepError
        from ptnsbc_tools.library import sweeping

        if scenario is None and self.family is None:
            raise SweepError("expected a SCENARIO or --family")
        keys = self.keys()
        return sweeping.plan(
            scenario_with(scenario or _BASE, keys),
            self.runs,
            vary=self.vary or (),
            starts=self.starts,
            family=self.family,
            overrides=keys,
            name=self.name,
            seed=self.draw_seed,
            stop_after_s=self.stop_after,
            check=self.check,
        )


def sweep(
    draws: Draws,
    scenario: Annotated[
        str | None,
        argument(
            "[SCENARIO]",
            f"A scenario file, or a name. With --family: the vehicle and gains, by default {_BASE}.",
        ),
    ] = None,
    out: Annotated[
        Path | None, option("--output -o DIR", "Folder. Default: out/sweeps/NAME.")
    ] = None,
    workers: Annotated[
        int | None, option("--workers -j N", "Processes. Default: one per core.", 1, 256)
    ] = None,
    report: Annotated[
        bool, option("--report/--no-report", "Write a page and figures into DIR/report.")
    ] = True,
    overwrite: Annotated[
        bool, option("--overwrite", "Replace a sweep of another plan, or of other laws, in DIR.")
    ] = False,
    strict: StrictOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    list_families: Annotated[
        bool, option("--list-families", "Print the families that can be given by name.")
    ] = False,
) -> None:
    """Fly a scenario many times: the share that meets its deadline.

    A sweep that was ended early goes on where it ended: give the same command again. Exit code 0: all
    draws were flown, whatever their verdicts are. 1: some draws could not be flown; they are named.
    """
    from ptnsbc_tools.sweeps import summary
    from ptnsbc_tools.sweeps.summary import read_sweep

    if list_families:
        _print_families()
        return
    plan = draws.plan(scenario)
    folder = out or SWEEPS / plan.name
    searched = None
    if draws.search or draws.rare is not None or draws.promise:
        searched = _search(plan, folder, draws, workers, overwrite=overwrite)
        plan = searched.plan
    _clear(folder, plan, overwrite=overwrite or searched is not None)
    flown = _fly(plan, folder, workers)
    found = read_sweep(folder, strict=strict)
    page = None
    if report:
        from ptnsbc_tools.sweeps.sweep_report import write_report

        with console.patience("drawing"):
            page = write_report(found)
    if json:
        failed = [
            {"first": one.draws.start, "last": one.draws[-1], "error": one.error}
            for one in flown.failed
        ] + [{"first": k, "last": k, "error": cause} for k, cause in found.not_flown]
        files = {"table": str(flown.table), "report": str(page) if page else None}
        about = {"search": searched.as_json()} if searched is not None else {}
        console.print_json({**summary.as_json(found), **about, "failed": failed, **files})
    else:
        if searched is not None:
            _show_search(searched)
        _show(found, flown, page, verbose=verbose)
    if found.missing:
        raise typer.Exit(_LACKING)


def _clear(folder: Path, plan: SweepPlan, *, overwrite: bool) -> None:
    """Remove a sweep of another plan or of other laws; other files in the folder stay, and have it refused."""
    from ptnsbc_sim.sweep.draws import SweepError
    from ptnsbc_sim.sweep.runner import held

    other = held(folder, plan)
    if not other:
        return
    if not overwrite:
        raise SweepError(f"{folder}: holds {other}: choose another --output, or --overwrite")
    for name in _MADE:
        made = folder / name
        if made.is_dir():
            shutil.rmtree(made)
        else:
            made.unlink(missing_ok=True)


def _search(
    plan: SweepPlan, folder: Path, draws: Draws, workers: int | None, *, overwrite: bool
) -> Found:
    from ptnsbc_sim.sweep.runner import SEARCH
    from ptnsbc_sim.sweep.search import search as search_draws

    place = folder / SEARCH
    promise = draws.promise and f"{draws.promise}_margin"
    about: dict[str, Any] = {"least": draws.rare, "promise": promise, "workers": workers}
    try:
        with console.progress("searching", None) as advance:
            return search_draws(plan, place, overwrite=overwrite, progress=advance, **about)
    except KeyboardInterrupt:
        console.say(f"interrupted: what was flown is in {place}; the same command goes on")
        raise typer.Exit(_INTERRUPTED) from None


def _show_search(searched: Found) -> None:
    """The probability, the least margin against flights flown, and what made the worst of them."""
    if (rare := searched.rare) is not None:
        shown = f"{rare.probability:.2g} ({rare.low:.2g} to {rare.high:.2g})"
        if rare.probability == 0.0:
            shown = f"at most {rare.high:.2g}"
        print(f"probability of a broken promise: {shown}, by {rare.flights} flights")
    so_far = ", ".join(f"{margin:+.3f} after {count}" for count, margin in searched.so_far())
    print(f"least margin, as a share of its promise: {so_far} flights")
    print(f"what made draw 0: {', '.join(searched.inputs(0))}")


def _fly(plan: SweepPlan, folder: Path, workers: int | None) -> SweepResult:
    from ptnsbc_sim.sweep.draws import SweepError
    from ptnsbc_tools.library.sweeping import fly_plan

    done = [0]
    try:
        return fly_plan(plan, folder, workers=workers, count=done.append)
    except KeyboardInterrupt:
        console.say(
            f"interrupted: {done[-1]} of {plan.draws} flights are kept in {folder}; "
            "the same command goes on from there"
        )
        raise typer.Exit(_INTERRUPTED) from None
    except OSError as error:
        raise SweepError(f"{folder}: {error}") from error


def _show(found: FlownSweep, flown: SweepResult, page: Path | None, *, verbose: bool) -> None:
    """Say who met and was in place in a line, then the shares and distances; `verbose`: all tables."""
    from ptnsbc_tools.sweeps import summary
    from ptnsbc_tools.tables import print_plain

    out = console.out()
    out.print(summary.title(found), summary.line(found), sep="\n", soft_wrap=not out.is_terminal)
    for table in summary.tables(found, brief=not verbose):
        out.print(table) if verbose else print_plain(table)
    out.print()
    for line in summary.look_first(found, _MOST_NAMED if verbose else 1):
        print(line)
    for failed in flown.failed:
        first, last = failed.draws.start, failed.draws[-1]
        print(f"draws {first} to {last} were not flown: {failed.error}", file=sys.stderr)
    for draw, cause in found.not_flown[:_MOST_NAMED]:
        print(f"draw {draw} was not flown: {cause}", file=sys.stderr)
    if (rest := len(found.not_flown) - _MOST_NAMED) > 0:
        print(f"{rest} more were not flown: their causes are in the table", file=sys.stderr)
    print(f"table: {flown.table}")
    if page is not None:
        print(f"report: {page}")


def compare(
    a: Annotated[Path, argument("A", "Folder or --name of a sweep, or a bag.")],
    others: Annotated[list[Path], argument("B...", "One or more others of the same kind.")],
    margin: Annotated[
        float, option("--margin M", "An error that grew by less is not worse.", 0.0, FARTHEST_M)
    ] = 0.001,
    seed: Annotated[int, option("--seed N", "Seed of the bootstrap.", 0)] = 0,
    json: JsonOption = False,
) -> None:
    """Say whether others are worse than A: what was met and the errors, paired by draw, with intervals.

    One is worse when it meets the deadline in fewer flights, or when the largest error after the deadline
    has grown in the median, and that is no chance at 5 %: with several others for all together. Exit code 0: none
    is worse. 1: one is worse. 2: they cannot be compared.
    """
    from ptnsbc_tools.library import sweeping
    from ptnsbc_tools.sweeps import comparison

    with console.patience("reading"):
        first, *rest = _opened([a, *others])
        names = [str(one) for one in others]
        found = sweeping.compare(first, *rest, names=names, margin_m=margin, seed=seed)
    if json:
        each = [comparison.as_json(one) for one in found.others]
        console.print_json({"a": str(a), "worse": found.worse, "others": each})
    else:
        console.out().print(found.summary.table())
        for one in found.others:
            console.show(str(one))
    if found.worse:
        raise typer.Exit(_WORSE)


def _opened(paths: list[Path]) -> list[Any]:
    """The sweeps or the flights; a name means the folder where `ptnsbc sweep` puts the sweep of this name."""
    from ptnsbc_sim.sweep.runner import PLAN
    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.library.sweeping import open_sweep
    from ptnsbc_tools.sweeps.comparison import ComparisonError

    found = []
    for given in paths:
        named = not given.exists() and (SWEEPS / given).is_dir()
        path = SWEEPS / given if named else given
        if not path.exists():
            raise ComparisonError(
                f"{path}: no such sweep or bag, and no sweep of that name in {SWEEPS}"
            )
        found.append(open_sweep(path) if (path / PLAN).is_file() else flight_in(path))
    return found
