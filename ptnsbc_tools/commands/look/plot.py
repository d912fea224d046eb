"""`ptnsbc plot`: the figures of a flight as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_tools.plotting.flight import FlightView

_ALL = "all"


class PlotError(PtnsbcError):
    """A figure that does not exist, or has nothing to show."""


def plot(
    context: typer.Context,
    bag: options.BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR|FILE",
            help="Folder, FILE.pdf for all figures, or FILE.png or FILE.svg for one. "
            "Default: BAG-figures beside the bag.",
        ),
    ] = None,
    what: Annotated[
        str,
        typer.Option(
            "--what",
            metavar="NAMES",
            help="all, or some of: errors, inputs, separations, force, force-first, torque, torque-first, "
            "between, obstacles, estimator, gain, conditioning, missed, latency, age; separated by commas.",
        ),
    ] = _ALL,
    form: Annotated[
        Literal["png", "svg", "pdf"],
        typer.Option("--format", help="Format of the files in a folder."),
    ] = "png",
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
    json: options.JsonOption = False,
) -> None:
    """Draw a recorded flight: errors, inputs, separations, estimator, gain, timing."""
    from mimetypes import guess_type

    from ptnsbc_tools.plotting import draw
    from ptnsbc_tools.plotting.flight import read_view

    keys = _keys(what)
    one = out is not None and out.suffix.lower() in draw.FORMATS
    pages = out if out is not None and out.suffix.lower() == ".pdf" else None
    if out is not None and not one and not out.is_dir() and guess_type(out.name)[0] is not None:
        formats = f"{', '.join(draw.FORMATS[:-1])} or {draw.FORMATS[-1]}"
        raise PlotError(f"--output {out}: expected a folder, or FILE with {formats}")
    if one and pages is None and len(keys) != 1:
        raise PlotError(
            f"--output {out}: one file for {len(keys)} figures: expected a folder, or --what with one name"
        )
    with console.patience(f"reading {bag}"):
        shown = read_view(bag, options.read_options(context))
    if shown.problem:
        console.err().print(f"warning: no verdict: {shown.problem}", soft_wrap=True)
    folder = out or bag.parent / f"{bag.stem if bag.is_file() else bag.name}-figures"
    written = _draw(shown, keys, folder, f".{form}", one, pages)
    if json:
        console.print_json({"figures": [str(path) for path in written]})
    else:
        for path in written:
            print(path)


def _keys(what: str) -> list[str]:
    from ptnsbc_tools.plotting.charts import CHARTS

    groups = {
        _ALL: list(CHARTS),
        "inputs": ["force", "force-first", "torque", "torque-first"],
        "separations": ["between", "obstacles"],
        **{key: [key] for key in CHARTS},
    }
    names = [name.strip() for name in what.split(",") if name.strip()]
    unknown = [name for name in names if name not in groups]
    if unknown or not names:
        raise PlotError(f"--what {what}: expected one or more of {', '.join(groups)}")
    return list(dict.fromkeys(key for name in names for key in groups[name]))


def _draw(
    shown: FlightView, keys: list[str], out: Path, suffix: str, one: bool, pages: Path | None
) -> list[Path]:
    from ptnsbc_tools.plotting import draw
    from ptnsbc_tools.plotting.charts import CHARTS

    written: list[Path] = []
    figures: list[Any] = []
    with console.progress("drawing") as advance:
        for done, key in enumerate(keys, start=1):
            chart = CHARTS[key](shown) if shown.uavs else None
            if chart is not None:
                figures.append(draw.figure_of(chart, shown.scenario.name))
                path = out if one else out / f"{key}{suffix}"
                if pages is None:
                    written.append(draw.save(figures.pop(), path))
            advance(done, len(keys))
    if pages is not None and figures:
        written.append(draw.save_pages(figures, pages))
    if not written:
        reason = shown.problem or "the bag has no data for it"
        raise PlotError(f"nothing to draw for {', '.join(keys)}: {reason}")
    return written
