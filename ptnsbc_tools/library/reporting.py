"""The page of a recorded flight: the function behind `ptnsbc report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.files import replacing
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.plotting.flight import FlightView, read_view
from ptnsbc_tools.reading.bag_reader import DEFAULTS, ReadOptions


class ReportError(PtnsbcError):
    """A report that cannot be made."""


@dataclass(frozen=True)
class Report:
    """The files that `report` wrote."""

    page: Path
    pictures: tuple[Path, ...]
    verdict: str | None
    """The word of the verdict; None: the flight cannot be judged."""
    problem: str
    """The reason why the flight cannot be judged; empty when it can."""


def report(
    flight: Flight | str | Path,
    folder: str | Path | None = None,
    *,
    other: Flight | str | Path | None = None,
    options: ReadOptions = DEFAULTS,
    pictures: bool = True,
    progress: bool | None = None,
) -> Report:
    """Write the page of a recorded flight, as `ptnsbc report`; it works offline.

    Args:
        flight: a flight, the folder of a bag, or its .mcap file.
        folder: for the page; by default BAG-report beside the bag, of a flight without one SCENARIO-report here.
        other: another flight, whose curves are shown dotted.
        options: how to read a bag that another program wrote; a `Flight` is read already.
        pictures: write the figures as PNG beside the page.
        progress: show progress on stderr; by default in a terminal and in a notebook.

    Raises:
        ReportError: no such bag.
        PtnsbcError: a bag cannot be read; nothing is written.
    """
    bag = flight.bag if isinstance(flight, Flight) else Path(flight)
    shown = _view_of(flight, options)
    beside_bag = (Path() if bag is None else bag.parent) / f"{shown.name}-report"
    target = beside_bag if folder is None else Path(folder)
    beside = None if other is None else _view_of(other, options)
    page = _write_page(bag, target, shown, beside)
    drawn = _draw(shown, target, progress) if pictures and shown.uavs else ()
    word = None if shown.verdict is None else shown.verdict.verdict
    return Report(page, drawn, word, shown.problem or "")


def _view_of(flight: Flight | str | Path, options: ReadOptions) -> FlightView:
    if isinstance(flight, Flight):
        return flight.view
    if not Path(flight).exists():
        raise ReportError(f"{flight}: no such bag")
    return read_view(Path(flight), options)


def _write_page(
    bag: Path | None, folder: Path, shown: FlightView, beside: FlightView | None
) -> Path:
    from ptnsbc_tools.report.page import page

    metadata = {"mode": "headless"} if bag is None else _metadata(bag)
    path, text = folder / "index.html", page(shown, metadata, beside)
    with replacing(path) as part:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
    return path


def _metadata(bag: Path) -> dict[str, str]:
    from ptnsbc_io.bag import BagError, read_bag

    try:
        return dict(read_bag(bag).metadata)
    except BagError:  # sqlite3 of other systems, which has no metadata
        return {}


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
