"""`ptnsbc report BAG`: one page that shows the flight and its verdict, and the figures as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_tools.commands.verify import ReadOptions
    from ptnsbc_tools.plotting.flight import Shown

PAGE = "index.html"
NO_VERDICT = 1


class ReportError(PtnsbcError):
    """A report that cannot be made."""


def report(
    bag: options.BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder for the page. Default: BAG-report beside it."
        ),
    ] = None,
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Figures as PNG beside the page.")
    ] = True,
    json: options.JsonOption = False,
) -> None:
    """Show a recorded flight: one page that works offline, with playback and figures.

    Exit code 0 when the page shows a verdict, whatever it is; 1 when the flight cannot be judged: the
    page then says why, and shows what there is; 2 when the bag cannot be read: nothing is written.
    """
    if not bag.exists():
        raise ReportError(f"{bag}: no such bag")
    from ptnsbc_tools.commands.verify import ReadOptions
    from ptnsbc_tools.reading.foreign import Names

    names = Names(odom=odom, wrench=wrench)
    choice = ReadOptions(scenario, tolerance, window, epoch, names)
    folder = out or bag.parent / f"{bag.stem if bag.is_file() else bag.name}-report"
    shown = _read(bag, choice)
    path = _write_page(bag, folder, shown)
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
        raise typer.Exit(NO_VERDICT)


def _read(bag: Path, choice: ReadOptions) -> Shown:
    from ptnsbc_tools.plotting import flight

    with console.patience(f"reading {bag}"):
        return flight.read_shown(bag, choice)


def _about(bag: Path) -> dict[str, str]:
    from ptnsbc_io.bag import BagError, read_bag

    try:
        return dict(read_bag(bag).metadata)
    except BagError:  # of others, sqlite3: says nothing about itself
        return {}


def _write_page(bag: Path, folder: Path, shown: Shown) -> Path:
    from ptnsbc_tools.report.page import page

    text = page(shown, _about(bag))
    path, beside = folder / PAGE, folder / f".{PAGE}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        beside.write_text(text, encoding="utf-8")
        return beside.replace(path)
    except OSError as error:
        raise ReportError(f"{path}: cannot be written: {error.strerror}") from error


def _draw(shown: Shown, folder: Path) -> list[Path]:
    from ptnsbc_tools.plotting import draw
    from ptnsbc_tools.plotting.build import CHARTS

    drawn: list[Path] = []
    with console.progress("drawing") as advance:
        for done, (key, make) in enumerate(CHARTS.items(), start=1):
            chart = make(shown)
            if chart is not None:
                figure = draw.figure_of(chart, shown.scenario.name)
                drawn.append(draw.save(figure, folder / f"{key}.png"))
            advance(done, len(CHARTS))
    return drawn
