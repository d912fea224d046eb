"""`ptnsbc report`: one page that shows the flight and its verdict, and the figures as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import console, options
from ptnsbc_tools.quick_start import spare_compiler

_NO_VERDICT = 1


def report(
    context: typer.Context,
    bag: options.BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder for the page. Default: BAG-report beside the bag.",
        ),
    ] = None,
    other: Annotated[
        Path | None,
        typer.Option(
            "--with", metavar="BAG", help="Another flight, whose curves are shown dotted."
        ),
    ] = None,
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
    pictures: Annotated[
        bool,
        typer.Option("--pictures/--no-pictures", help="Write the figures as PNG beside the page."),
    ] = True,
    json: options.JsonOption = False,
) -> None:
    """Show a recorded flight: one page that works offline, with playback and figures.

    Exit code 0: the page shows a verdict, whatever it is. 1: the flight cannot be judged; the page
    says why and shows what is recorded. 2: the bag cannot be read; nothing is written.
    """
    spare_compiler(bag)
    from ptnsbc_tools.library import reporting

    with console.patience(f"reading {bag}"):
        made = reporting.report(
            bag,
            out,
            other=other,
            options=options.read_options(context),
            pictures=pictures,
            progress=True,
        )
    if json:
        console.print_json(
            {
                "report": str(made.page),
                "pictures": [str(picture) for picture in made.pictures],
                "verdict": made.verdict,
                "problem": made.problem or None,
            }
        )
    else:
        print(made.page)
    if made.problem:
        console.err().print(f"warning: no verdict: {made.problem}", soft_wrap=True)
        raise typer.Exit(_NO_VERDICT)
