"""The page of a recorded flight: the function behind `ptnsbc report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.files import replacing
from ptnsbc_tools.plotting.flight import FlightView, read_view
from ptnsbc_tools.reading.bag_reader import DEFAULTS, ReadOptions


class ReportError(PtnsbcError):
    """A report that cannot be made."""


@dataclass(frozen=True)
class Report:
    """What `report` wrote."""

    page: Path
    pictures: tuple[Path, ...]
    verdict: str | None
    """The word of the verdict; None: the flight cannot be judged."""
    problem: str
    """Why the flight cannot be judged; empty when it can."""


def report(
    bag: str | Path,
    folder: str | Path | None = None,
    *,
    other: str | Path | None = None,
    options: ReadOptions = DEFAULTS,
    pictures: bool = True,
    progress: bool | None = None,
) -> Report:
    """Write the page of a recorded flight, as `ptnsbc report`; it works offline.

    Args:
        bag: folder of the bag, or its .mcap file.
        folder: for the page; by default BAG-report beside the bag.
        other: another flight, whose curves are shown dotted.
        options: how to read a bag that another program wrote.
        pictures: write the figures as PNG beside the page.
        progress: show progress on stderr; by default in a terminal and in a notebook.

    Raises:
        ReportError: no such bag.
        PtnsbcError: a bag cannot be read; nothing is written.
    """
    source = Path(bag)
    if not source.exists():
        raise ReportError(f"{source}: no such bag")
    name = source.stem if source.is_file() else source.name
    target = source.parent / f"{name}-report" if folder is None else Path(folder)
    shown = read_view(source, options)
    beside = None if other is None else read_view(Path(other), options)
    page = _write_page(source, target, shown, beside)
    drawn = _draw(shown, target, progress) if pictures and shown.uavs else ()
    word = None if shown.verdict is None else shown.verdict.verdict
    return Report(page, drawn, word, shown.problem or "")


def _write_page(bag: Path, folder: Path, shown: FlightView, beside: FlightView | None) -> Path:
    from ptnsbc_io.bag import BagError, read_bag
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


def _draw(shown: FlightView, folder: Path, progress: bool | None) -> tuple[Path, ...]:
    from ptnsbc_tools.plotting import draw
    from ptnsbc_tools.plotting.charts import CHARTS

    drawn: list[Path] = []
    with console.progress("drawing", progress) as advance:
        for done, (key, make) in enumerate(CHARTS.items(), start=1):
            chart = make(shown)
            if chart is not None:
                figure = draw.figure_of(chart, shown.scenario.name)
                drawn.append(draw.save(figure, folder / f"{key}.png"))
            advance(done, len(CHARTS))
    return tuple(drawn)
