"""Flights and sweeps as Arrow tables, written as CSV or Parquet."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools.files import replacing
from ptnsbc_tools.library.flight import Flight

if TYPE_CHECKING:  # half the memory of an export of a flight
    from ptnsbc_tools.library.sweeping import Sweep

FORMATS = (".csv", ".parquet")
_READ_MCAP = {".rrd": "Rerun", ".ulg": "PlotJuggler"}


class ExportError(PtnsbcError):
    """A file that no table can be written to."""


def checked(path: Path) -> Path:
    """The path, when its suffix names a format; ExportError else."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        viewer = _READ_MCAP.get(suffix)
        way = f"; {viewer} opens the .mcap file of the bag itself" if viewer else ""
        raise ExportError(
            f"{path}: suffix {suffix or 'missing'}: expected {' or '.join(FORMATS)}{way}"
        )
    return path


def export(source: Flight | Sweep, file: str | Path) -> Path:
    """Write a flight or a sweep as a table, as `ptnsbc export`, and return the file.

    Args:
        source: a flight, or a sweep.
        file: FILE.csv or FILE.parquet.

    Raises:
        ExportError: no such format.
        OutputFileError: the file cannot be written.
    """
    path = checked(Path(file))
    write(of_flight(source) if isinstance(source, Flight) else of_sweep(source), path)
    return path


def of_flight(flight: Flight) -> Any:
    """One row for each instant and UAV, as an Arrow table."""
    return _table(flight.columns(), {"scenario": flight.scenario.name})


def of_sweep(sweep: Sweep) -> Any:
    """One row for each UAV and flight, as an Arrow table."""
    columns = ((name, sweep.units[name], values) for name, values in sweep.columns.items())
    return _table(columns, {"plan": sweep.plan.name})


def _table(columns: Iterable[tuple[str, str, Any]], about: dict[str, str]) -> Any:
    import pyarrow as pa

    fields, arrays = [], []
    for name, unit, values in columns:
        array = _column(np.ascontiguousarray(values))
        fields.append(pa.field(name, array.type, metadata={"unit": unit}))
        arrays.append(array)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=about))


def _column(values: NDArray[Any]) -> Any:
    """An Arrow array; `pyarrow.array` would import pandas where it is installed, for a third of a second."""
    import pyarrow as pa

    if values.dtype.kind not in "iuf":
        return pa.array(values)
    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, values.size, [None, pa.py_buffer(values)])


def write(table: Any, path: Path) -> None:
    """Write a table; the suffix says in which format.

    Raises:
        OutputFileError: the file cannot be written.
    """
    with replacing(path) as part:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".csv":
            import pyarrow.csv

            pyarrow.csv.write_csv(table, part)
        else:
            import pyarrow.parquet

            pyarrow.parquet.write_table(table, part)
