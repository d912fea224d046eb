"""The command line of the experiments, which `ptnsbc reproduce` starts in a clone."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from paper.catalogue import EXPERIMENTS
from ptnsbc_tools.options import JsonOption, SetOption

_NAMES = ", ".join(one.name for one in EXPERIMENTS)

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def reproduce(
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for everything made.")
    ] = Path("out/reproduce"),
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help=f"This part alone, repeatable: {_NAMES}."),
    ] = None,
    jobs: Annotated[
        int,
        typer.Option("--workers", "-j", metavar="N", min=1, max=64, help="Processes at a time."),
    ] = 2,
    docs: Annotated[
        Path | None,
        typer.Option(
            "--docs",
            metavar="DIR",
            help="Write DIR/results.md, DIR/tables.md and their pictures too.",
        ),
    ] = None,
    settings: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Fly the paper again: its figures, the baselines, our ablations, and a verdict on each claim.

    Writes figures (PNG, SVG), every curve in them (CSV), the table of every sweep (Parquet),
    results.md, tables.md and results.json. The same
    command gives the same bytes, except for what is measured by the clock: timing.json and the
    part `cost` of tables.md.
    """
    from paper import output
    from paper.catalogue import select
    from ptnsbc_sim.scenario.reading.reader import set_keys
    from ptnsbc_tools import console

    experiments = select(only)
    changes = set_keys(settings or ())
    output.check_free(folder, [one.name for one in experiments])
    # Not above: this loads the laws, and a refusal does not wait for them.
    from paper import flights, report, runner

    with flights.using(changes), output.temporary_folder(folder) as place:
        with console.compiling():  # once here, or every process would compile for itself
            flights.compile_laws()
        with runner.progress_shown(experiments) as on_progress:
            results = runner.run_all(experiments, place, jobs, on_progress, changes)
        origin = report.Origin.of(_command(only, docs, settings))
        report.write(origin, results, place)
        if docs is not None:
            report.write_docs(origin, results, place, docs)
    if json:
        console.print_json({**report.summary(results), "folder": str(folder)})
        return
    console.out().print(report.claims_table(results))
    print(f"results: {folder / 'results.md'}")


def _command(only: list[str] | None, docs: Path | None, settings: list[str] | None) -> str:
    """The command line that repeats this run, without the options that change no result."""
    words = ["ptnsbc", "reproduce"]
    for name in only or ():
        words += ["--only", name]
    for setting in settings or ():
        words += ["--set", setting]
    return shlex.join(words + (["--docs", str(docs)] if docs else []))
