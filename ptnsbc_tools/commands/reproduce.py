"""`ptnsbc reproduce`: fly the paper again, draw its figures, judge its claims."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_tools.options import JsonOption, SetOption
from ptnsbc_tools.reproduce.catalogue import EXPERIMENTS

if TYPE_CHECKING:
    from ptnsbc_tools.reproduce.catalogue import Experiment
    from ptnsbc_tools.reproduce.runner import TimedResult

_NAMES = ", ".join(one.name for one in EXPERIMENTS)


def reproduce(
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for everything made.")
    ] = Path("out/reproduce"),
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help=f"This part alone, repeatable: {_NAMES}."),
    ] = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, max=64, help="Processes at a time.")
    ] = 2,
    docs: Annotated[
        Path | None,
        typer.Option("--docs", metavar="DIR", help="Write DIR/results.md and its pictures too."),
    ] = None,
    settings: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Fly the paper again: its figures, the baselines, our ablations, and a verdict on each claim.

    Writes figures (PNG, SVG), every curve in them (CSV), results.md and results.json. The same
    command gives the same bytes, except for what is measured by the clock: timing.json and the
    part `cost` of results.md.
    """
    from ptnsbc_tools import options
    from ptnsbc_tools.reproduce import folder as folders
    from ptnsbc_tools.reproduce.catalogue import chosen

    experiments = chosen(only)
    given = options.overrides(settings=settings)
    folders.refuse(folder, [one.name for one in experiments])
    from ptnsbc_tools.reproduce import flights  # not above: loads the laws, a refusal need not wait

    with flights.using(given), folders.beside(folder) as place:
        made = _run(experiments, place, jobs, given)
        _report(made, place, docs, _command(only, docs, settings))
    _show(made, folder, json=json)


def _run(
    experiments: tuple[Experiment, ...], place: Path, jobs: int, given: dict[str, Any]
) -> list[TimedResult]:
    from ptnsbc_tools import console
    from ptnsbc_tools.reproduce import progress
    from ptnsbc_tools.reproduce.runner import run_all

    with console.compiling():  # once here, or every process would compile for itself
        from ptnsbc_tools.reproduce import flights

        flights.warm()
    with progress.shown(experiments) as tell:
        return run_all(experiments, place, jobs, tell, given)


def _command(only: list[str] | None, docs: Path | None, settings: list[str] | None) -> str:
    """The command as it should be repeated: without what changes no result."""
    words = ["ptnsbc", "reproduce"]
    for name in only or ():
        words += ["--only", name]
    for setting in settings or ():
        words += ["--set", setting]
    return shlex.join(words + (["--docs", str(docs)] if docs else []))


def _report(made: list[TimedResult], place: Path, docs: Path | None, command: str) -> None:
    from ptnsbc_tools.reproduce import report, source
    from ptnsbc_tools.reproduce.document import Origin

    origin = Origin(command, source.commit(), source.digest(), source.seeds())
    report.write(origin, made, place)
    if docs is not None:
        report.write_docs(origin, made, place, docs)


def _show(made: list[TimedResult], folder: Path, *, json: bool) -> None:
    from ptnsbc_tools import console
    from ptnsbc_tools.reproduce import report

    if json:
        console.print_json({**report.summary(made), "folder": str(folder)})
        return
    console.out().print(report.claims_table(made))
    print(f"results: {folder / 'results.md'}")
