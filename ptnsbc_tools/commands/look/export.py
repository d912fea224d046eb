"""`ptnsbc export`: the quantities of a flight, or the rows of a sweep, as a table for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import console, options


def export(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="BAG", help="A bag, or the folder of a sweep.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="FILE.csv or FILE.parquet. Default: BAG.csv beside the bag.",
        ),
    ] = None,
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
) -> None:
    """Write a table: one row for each instant and UAV of a flight, or the rows of a sweep.

    The names of columns end in their unit, and a Parquet file has the unit of each column in its
    metadata. Times count from the epoch; ENU is the world frame. Foxglove, PlotJuggler and Rerun read the
    .mcap file of a bag as it is.
    """
    from ptnsbc_tools.library.export import checked
    from ptnsbc_tools.library.export import export as write
    from ptnsbc_tools.library.flight import flight_in

    beside = source.parent / f"{source.stem if source.is_file() else source.name}.csv"
    path = checked(beside if output is None else output)
    with console.patience(f"reading {source}"):
        if _is_sweep(source):
            from ptnsbc_tools.library.sweeping import open_sweep

            write(open_sweep(source), path)
        else:
            write(flight_in(source, options.read_options(context)), path)
    console.show(str(path))


def _is_sweep(source: Path) -> bool:
    """Whether this is the folder of a sweep: only then is the code of sweeps imported."""
    from ptnsbc_io.bag.metadata import METADATA_FILE

    if not source.is_dir() or (source / METADATA_FILE).exists():
        return False
    from ptnsbc_sim.sweep.runner import PLAN

    return (source / PLAN).is_file()
