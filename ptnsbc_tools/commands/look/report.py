"""`ptnsbc report`: one page that shows the flight and its verdict, and the figures as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_tools.plotting.flight import FlightView

_NO_VERDICT = 1


class ReportError(PtnsbcError):
    """A report that cannot be made."""


def report(
    context: typer.Context,
    bag: options.BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            "--out",
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
    if not bag.exists():
        raise ReportError(f"{bag}: no such bag")
    from ptnsbc_tools.plotting.flight import read_view

    folder = out or bag.parent / f"{bag.stem if bag.is_file() else bag.name}-report"
    with console.patience(f"reading {bag}"):
        shown = read_view(bag, options.read_options(context))
        beside = None if other is None else read_view(other, options.read_options(context))
    path = _write_page(bag, folder, shown, beside)
    drawn = _draw(shown, folder) if pictures and shown.uavs else []
    if json:
        console.print_json(
            {
                "report": str(path),
                "pictures": [str(picture) for picture in drawn],
                "verdict": shown.verdict.verdict if shown.verdict is not None else None,
                "problem": shown.problem or None,
            }
        )
    else:
        print(path)
    if shown.problem:
        console.err().print(f"warning: no verdict: {shown.problem}", soft_wrap=True)
        raise typer.Exit(_NO_VERDICT)


def _write_page(bag: Path, folder: Path, shown: FlightView, beside: FlightView | None) -> Path:
    from ptnsbc_io.bag import BagError, read_bag
    from ptnsbc_tools.files import replacing
    from ptnsbc_tools.report.page import page

    try:
        metadata = dict(read_bag(bag).metadata)
    except BagError:  # sqlite3 of other systems, which has no metadata
        metadata = {}
    path, text = folder / "index.html", page(shown, metadata, beside)
    with replacing(path) as part:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
    return path


def _draw(shown: FlightView, folder: Path) -> list[Path]:
    from ptnsbc_tools.plotting import draw
    from ptnsbc_tools.plotting.charts import CHARTS

    drawn: list[Path] = []
    with console.progress("drawing") as advance:
        for done, (key, make) in enumerate(CHARTS.items(), start=1):
            chart = make(shown)
            if chart is not None:
                figure = draw.figure_of(chart, shown.scenario.name)
                drawn.append(draw.save(figure, folder / f"{key}.png"))
            advance(done, len(CHARTS))
    return drawn
