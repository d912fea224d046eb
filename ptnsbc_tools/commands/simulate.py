"""`ptnsbc simulate`: the whole swarm in this process, and its verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import console
from ptnsbc_tools.commands.check import preflight
from ptnsbc_tools.options import (
    BagOption,
    FlightChoices,
    OverwriteOption,
    PictureOption,
    Showing,
    argument,
    option,
)


def simulate(
    choices: FlightChoices,
    scenario: Annotated[
        str | None,
        argument(
            "[SCENARIO]", "A scenario file, or a name such as paper_5; or --sweep and --draw."
        ),
    ] = None,
    sweep: Annotated[
        Path | None, option("--sweep DIR", "Fly a draw of the sweep in this folder.")
    ] = None,
    draw: Annotated[int | None, option("--draw K", "The draw to fly; with --sweep.", 0)] = None,
    picture: PictureOption = None,
    bag: BagOption = None,
    overwrite: OverwriteOption = False,
    *,
    showing: Showing,
) -> None:
    """Fly a scenario in this process, without ROS, and judge it."""
    from ptnsbc_sim.track import refuse_without_memory
    from ptnsbc_tools.library.flying import fly
    from ptnsbc_tools.plotting.draw import format_of
    from ptnsbc_tools.reading.headless import prepare_bag
    from ptnsbc_tools.tables import show_verdict

    if sweep is None and draw is None and scenario is not None:
        chosen = choices.of(scenario)
    else:
        from ptnsbc_sim.scenario import scenario_from_text
        from ptnsbc_sim.sweep.draws import SweepError
        from ptnsbc_sim.sweep.plan import draw as draw_of
        from ptnsbc_tools.sweeps.summary import plan_in

        if scenario is not None or sweep is None or draw is None:
            raise SweepError("expected a SCENARIO, or --sweep DIR and --draw K")
        chosen, keys = draw_of(plan_in(sweep), draw), choices.keys()
        if keys:
            chosen = scenario_from_text(chosen.text, keys, source=chosen.source)
    if picture is not None:
        format_of(picture)  # refused before the flight, not after it
    refuse_without_memory(chosen)  # the check of a flight of ages takes ages
    preflight(chosen, quiet=showing.json, refusing=sweep is None)
    if bag is not None:
        prepare_bag(bag, overwrite=overwrite)

    flight = fly(chosen, checked=False, progress=True)
    if bag is not None:
        with console.progress("recording") as advance:
            bag = flight.save(bag, overwrite=overwrite, progress=advance).bag
    if picture is not None:
        flight.save_picture(picture)
    code = show_verdict(flight.verdict, showing, bag=bag, picture=picture)
    if bag is None and not showing.json:
        console.show("next: record it with --bag DIR, then ptnsbc report DIR")
    raise typer.Exit(code)
