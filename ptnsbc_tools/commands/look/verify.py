"""`ptnsbc verify`: the verdict on a recorded flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import options
from ptnsbc_tools.quick_start import spare_compiler


def verify(
    context: typer.Context,
    bag: options.BagArgument,
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Draw the flight as a PNG, SVG or PDF."),
    ] = None,
    json: options.JsonOption = False,
) -> None:
    """Judge a recorded flight: met, missed, violated or void, with input, energy and separations.

    A UAV that entered a keep-out is violated. An error counts from the epoch on, outside encounters.
    An encounter is a span in which the UAV, or one that it follows, avoids something, and a recovery
    time after it. The settling time is the last exit from the band: 2 % of the start error or the
    tolerance, whichever is larger. Each formation leg is judged. Bags of other systems (MCAP, sqlite3)
    need --scenario and the names of their topics.
    """
    spare_compiler(bag)
    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.tables import show_verdict

    flight = flight_in(bag, options.read_options(context))
    verdict = flight.verdict
    drawn = None if picture is None else flight.save_picture(picture)
    show_verdict(verdict, json=json, picture=drawn)
    raise typer.Exit(verdict.exit_code)
