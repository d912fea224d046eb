"""Files made of flights: the page of `ptnsbc report`, and the tables of `ptnsbc export`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from arro3.core import Array, Field, Schema, Table
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import read_bag
from ptnsbc_io.files import replacing
from ptnsbc_tools.library.flight import Flight, flight_in
from ptnsbc_tools.limits import path_of
from ptnsbc_tools.options import AS_RECORDED, ReadOptions

if TYPE_CHECKING:  # half the memory of an export of a flight
    from ptnsbc_tools.library.sweeping import Sweep

FORMATS = (".csv", ".parquet")
_READ_MCAP = {".rrd": "Rerun", ".ulg": "PlotJuggler"}


@dataclass(frozen=True)
class Report:
    """The page that `report` wrote."""

    page: Path
    verdict: str | None
    """The word of the verdict; None: the flight cannot be judged."""
    problem: str
    """The reason why the flight cannot be judged; empty when it can."""


def report(
    flight: Flight | str | Path,
    folder: str | Path | None = None,
    *,
    other: Flight | str | Path | None = None,
    options: ReadOptions = AS_RECORDED,
) -> Report:
    """Write the page of a recorded flight, as `ptnsbc report`; it works offline.

    Args:
        flight: a flight, the folder of a bag, or its .mcap file.
        folder: for the page; by default BAG-report beside the bag, of a flight without one SCENARIO-report here.
        other: another flight, whose curves are shown dotted.
        options: how to read a bag that another program wrote; a `Flight` is read already.

    Raises:
        BagError: a bag cannot be read; nothing is written.
    """
    from ptnsbc_tools.report.page import page as page_of

    flown = flight_in(flight, options)
    bag, shown = flown.bag, flown.view
    beside_bag = (Path() if bag is None else bag.parent) / f"{shown.name}-report"
    target = beside_bag if folder is None else path_of("folder", folder)
    beside = None if other is None else flight_in(other, options).view
    metadata = {"mode": "headless"} if bag is None else read_bag(bag).metadata
    page, text = target / "index.html", page_of(shown, metadata, beside)
    with replacing(page, folder=True) as part:
        part.write_text(text, encoding="utf-8")
    word = None if shown.verdict is None else shown.verdict.verdict
    return Report(page, word, shown.problem)


def checked(path: Path) -> Path:
    """The path, when its suffix names a format; PtnsbcError else."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        viewer = _READ_MCAP.get(suffix)
        way = f"; {viewer} opens the .mcap file of the bag itself" if viewer else ""
        raise PtnsbcError(
            f"{path}: suffix {suffix or 'missing'}: expected {' or '.join(FORMATS)}{way}"
        )
    return path


def export(source: Flight | Sweep | str | Path, file: str | Path) -> Path:
    """Write a flight, or that of a bag, or a sweep into FILE.csv or FILE.parquet, as `ptnsbc export`; return the file.

    PtnsbcError when there is no such format; OutputFileError when the file cannot be written.
    """
    from arro3.io import write_csv, write_parquet

    path = checked(path_of("file", file))
    if not isinstance(source, Flight):
        from ptnsbc_tools.library.sweeping import Sweep

        source = source if isinstance(source, Sweep) else flight_in(source)
    table = table_of(source)
    with replacing(path, folder=True) as part:
        if path.suffix.lower() == ".csv":
            write_csv(table, part)
        else:
            write_parquet(table, part, compression="zstd(1)")
    return path


def table_of(source: Flight | Sweep) -> Table:
    """An Arrow table: one row for each instant and UAV of a flight, or for each UAV and flight of a sweep."""
    columns: Iterable[tuple[str, str, NDArray[Any]]]
    if isinstance(source, Flight):
        columns, about = source.columns(), {"scenario": source.scenario.name}
    else:
        columns = ((name, source.units[name], column) for name, column in source.columns.items())
        about = {"plan": source.plan.name}
    fields, arrays = [], []
    for name, unit, values in columns:
        array = Array.from_numpy(np.ascontiguousarray(values))
        fields.append(Field(name, array.type, metadata={"unit": unit}))
        arrays.append(array)
    return Table.from_arrays(arrays, schema=Schema(fields, metadata=about))
