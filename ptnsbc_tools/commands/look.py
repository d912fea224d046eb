"""Commands that look at recorded flights: `ptnsbc verify`, `report`, `plot` and `export`; and `ptnsbc reproduce`."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.options import (
    BagArgument,
    JsonOption,
    PictureOption,
    ReadOptions,
    Showing,
    argument,
    option,
)

_NO_VERDICT = 1
_ALL = "all"
_CLONE = Path(__file__).resolve().parents[2]


def verify(
    bag: BagArgument, reading: ReadOptions, picture: PictureOption = None, *, showing: Showing
) -> None:
    """Judge a recorded flight: met, met late, missed, violated or void, and how near the UAVs came.

    A UAV that entered a keep-out is violated. An error counts from the epoch on, outside encounters.
    An encounter is a span in which the UAV, or one that it follows, avoids something, and a recovery
    time after it. The settling time is the last exit from the band: 2 % of the start error or the
    tolerance, whichever is larger. Each formation leg is judged. Bags of other systems (MCAP, sqlite3)
    need --scenario and the names of their topics.
    """
    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.tables import show_verdict

    with console.patience(f"reading {bag}"):
        flight = flight_in(bag, reading)
        verdict = flight.verdict
    drawn = None if picture is None else flight.save_picture(picture)
    raise typer.Exit(show_verdict(verdict, showing, picture=drawn))


def report(
    bag: BagArgument,
    reading: ReadOptions,
    out: Annotated[
        Path | None,
        option("--output -o DIR", "Folder for the page. Default: BAG-report beside the bag."),
    ] = None,
    other: Annotated[
        Path | None, option("--with BAG", "Another flight, whose curves are shown dotted.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show a recorded flight: a page with playback and figures.

    The page works without a network.
    Exit code 0: the page shows a verdict, whatever it is. 1: the flight cannot be judged; the page
    says why and shows what is recorded. 2: the bag cannot be read; nothing is written.
    """
    from ptnsbc_tools.library import reporting

    with console.patience(f"reading {bag}"):
        made = reporting.report(bag, out, other=other, options=reading)
    if json:
        about = {"verdict": made.verdict, "problem": made.problem or None}
        console.print_json({"report": str(made.page), **about})
    else:
        print(made.page)
        console.say("open it in a browser; it needs no network")
    if made.problem:
        console.err().print(f"warning: no verdict: {made.problem}", soft_wrap=True)
        raise typer.Exit(_NO_VERDICT)


def plot(
    bag: BagArgument,
    reading: ReadOptions,
    out: Annotated[
        Path | None,
        option(
            "--output -o DIR|FILE",
            "Folder, FILE.pdf for all figures, or FILE.png or FILE.svg for one. "
            "Default: BAG-figures beside the bag.",
        ),
    ] = None,
    what: Annotated[
        str,
        option(
            "--what NAMES",
            "all, or some of: errors, inputs, separations, force, torque, between, obstacles, estimator, gain, "
            "conditioning, missed, latency, age; separated by commas.",
        ),
    ] = _ALL,
    form: Annotated[
        Literal["png", "svg", "pdf"], option("--format", "Format of the files in a folder.")
    ] = "png",
    width: Annotated[
        Literal["one", "two"] | None,
        option("--width", "Columns of a journal: 3.5 or 7.16 in wide, without a title."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Draw a recorded flight: errors, inputs, separations, estimator, gain, timing."""
    from mimetypes import guess_type

    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.plotting import draw

    keys, kind = _keys(what), "" if out is None else out.suffix.lower()
    one = kind in draw.FORMATS
    if out is not None and not one and not out.is_dir() and guess_type(out.name)[0] is not None:
        raise PtnsbcError(f"--output {out}: expected a folder, or FILE with .png, .svg or .pdf")
    if one and kind != ".pdf" and len(keys) != 1:
        raise PtnsbcError(
            f"--output {out}: one file for {len(keys)} figures: expected a folder, or --what with one name"
        )
    with console.patience(f"reading {bag}"):
        shown = flight_in(bag, reading).view
    if shown.problem:
        console.err().print(f"warning: no verdict: {shown.problem}", soft_wrap=True)
    folder = out or bag.parent / f"{shown.name}-figures"
    pages, written = [], []
    with draw.sized(width), console.progress("drawing") as advance:
        for done, key in enumerate(keys, start=1):
            if chart := shown.chart(key):
                figure = draw.figure_of(chart, shown.scenario.name, width)
                if kind == ".pdf":
                    pages.append(figure)
                else:
                    file = folder if one else folder / f"{key}.{form}"
                    written.append(draw.save(figure, file))
            advance(done, len(keys))
        written += draw.save_pages(pages, folder)
    if not written:
        reason = shown.problem or "the bag has no data for it"
        raise PtnsbcError(f"nothing to draw for {', '.join(keys)}: {reason}")
    if json:
        console.print_json({"figures": [str(path) for path in written]})
    else:
        for path in written:
            print(path)


def _keys(what: str) -> list[str]:
    from ptnsbc_tools.plotting.charts import CHARTS

    groups = {
        _ALL: list(CHARTS),
        "inputs": ["force", "torque"],
        "separations": ["between", "obstacles"],
        **{key: [key] for key in CHARTS},
    }
    names = [name.strip() for name in what.split(",") if name.strip()]
    if not names or any(name not in groups for name in names):
        raise PtnsbcError(f"--what {what}: expected one or more of {', '.join(groups)}")
    return list(dict.fromkeys(key for name in names for key in groups[name]))


def export(
    source: Annotated[Path, argument("BAG", "A bag, or the folder of a sweep.")],
    reading: ReadOptions,
    output: Annotated[
        Path | None,
        option("--output -o FILE", "FILE.csv or FILE.parquet. Default: BAG.csv beside the bag."),
    ] = None,
) -> None:
    """Write a table: one row for each instant and UAV of a flight, or the rows of a sweep.

    The names of columns end in their unit, and a Parquet file has the unit of each column in its
    metadata. Times count from the epoch; ENU is the world frame. Foxglove, PlotJuggler and Rerun read the
    .mcap file of a bag as it is.
    """
    from ptnsbc_io.bag.metadata import METADATA_FILE
    from ptnsbc_tools.library import reporting
    from ptnsbc_tools.library.flight import flight_in

    name = source.stem if source.is_file() else source.resolve().name
    path = reporting.checked(output or source.parent / f"{name}.csv")
    with console.patience(f"reading {source}"):
        if (source / "plan.json").is_file() and not (source / METADATA_FILE).exists():
            from ptnsbc_tools.library.sweeping import open_sweep

            reporting.export(open_sweep(source), path)
        else:
            reporting.export(flight_in(source, reading), path)
    console.show(str(path))


def reproduce(context: typer.Context) -> None:
    """Fly the paper again: its figures, the baselines, our ablations, and a verdict on each claim.

    All words are those of `paper/`, `--help` too.
    """
    if not (_CLONE / "paper" / "command.py").is_file():
        raise PtnsbcError(
            f"{_CLONE}/paper: there is no such folder: expected a clone of the repository; "
            "run ptnsbc reproduce from its .venv (make setup)"
        )
    sys.path.insert(0, str(_CLONE))
    command = typer.main.get_command(import_module("paper.command").app)
    # Not `main`, which would turn an interrupt and an exit code into other ones.
    with command.make_context("ptnsbc reproduce", list(context.args)) as of_paper:
        command.invoke(of_paper)
