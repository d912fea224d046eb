"""`ptnsbc compare`: two sweeps, or two recorded flights, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_tools.sweeps.table import FlightTable

_WORSE = 1


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder or --name of a sweep, or a bag.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one of the same kind.")],
    margin: Annotated[
        float,
        typer.Option(
            "--margin", metavar="M", min=0.0, help="An error that grew by less is not worse."
        ),
    ] = 0.001,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Seed of the bootstrap.")
    ] = 0,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write the comparison as a page too."),
    ] = None,
    json: options.JsonOption = False,
) -> None:
    """Say whether B is worse than A: what was met and the errors, paired by draw, with intervals.

    B is worse when it meets the deadline in fewer flights, or when the largest error after the deadline
    has grown in the median, and that is no chance at 5 %. Exit code 0: B is not worse. 1: B is worse.
    2: the two cannot be compared.
    """
    from ptnsbc_tools.sweeps import comparison

    a, b = _found(a), _found(b)
    with console.patience("reading"):
        first, second = _both(a, b)
    found = comparison.compare(first, second, margin_m=margin, seed=seed)
    if html is not None:
        from ptnsbc_tools.sweeps.page import write_comparison

        with console.patience("drawing"):
            write_comparison(html, (str(a), str(b)), (first, second), found)
    if json:
        console.print_json({"a": str(a), "b": str(b), **comparison.as_json(found)})
    else:
        out = console.out()
        for table in comparison.tables(found):
            out.print(table)
        out.print(comparison.line(found), soft_wrap=True)
        if html is not None:
            print(f"page: {html}")
    if found.worse:
        raise typer.Exit(_WORSE)


def _found(path: Path) -> Path:
    """The path, or the folder where `ptnsbc sweep` puts the sweep of this name."""
    named = options.SWEEPS / path
    return named if not path.exists() and named.is_dir() else path


def _both(a: Path, b: Path) -> tuple[FlightTable, FlightTable]:
    from ptnsbc_sim.sweep.runner import PLAN
    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.library.sweeping import compared, open_sweep
    from ptnsbc_tools.sweeps.comparison import ComparisonError

    for path in (a, b):
        if not path.exists():
            raise ComparisonError(
                f"{path}: no such sweep or bag, and no sweep of that name in {options.SWEEPS}"
            )
    kinds = {(path / PLAN).is_file() for path in (a, b)}
    if len(kinds) > 1:
        raise ComparisonError(f"{a}, {b}: expected two sweeps or two bags")
    if kinds == {False}:
        return compared(flight_in(a), flight_in(b))
    return compared(open_sweep(a), open_sweep(b))
