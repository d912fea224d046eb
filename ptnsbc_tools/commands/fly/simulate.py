"""`ptnsbc simulate`: the whole swarm in this process, and its verdict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_tools import console, options
from ptnsbc_tools.commands.begin.check import preflight

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario


def simulate(
    context: typer.Context,
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENARIO]",
            help="A scenario file, or a name such as paper_5; or --sweep and --draw.",
        ),
    ] = None,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    seed: options.SeedOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    mission: options.MissionOption = None,
    sweep: Annotated[
        Path | None,
        typer.Option("--sweep", metavar="DIR", help="Fly a draw of the sweep in this folder."),
    ] = None,
    draw: Annotated[
        int | None,
        typer.Option("--draw", metavar="K", min=0, help="The draw to fly; with --sweep."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Draw the flight as a PNG, SVG or PDF."),
    ] = None,
    bag: options.BagOption = None,
    overwrite: options.OverwriteOption = False,
    json: options.JsonOption = False,
) -> None:
    """Fly a scenario in this process, without ROS, as fast as possible; ends with the verdict."""
    from ptnsbc_sim.track import refuse_without_memory
    from ptnsbc_tools.library.flying import fly
    from ptnsbc_tools.plotting.draw import format_of
    from ptnsbc_tools.reading.headless import prepare_bag
    from ptnsbc_tools.tables import show_verdict

    if sweep is None and draw is None and scenario is not None:
        chosen = options.chosen(context)
    else:
        chosen = _drawn(context, scenario, sweep, draw)
    if picture is not None:
        format_of(picture)  # refused before the flight, not after it
    refuse_without_memory(chosen)  # the check of a flight of ages takes ages
    preflight(chosen, quiet=json, refusing=sweep is None)
    if bag is not None:
        prepare_bag(bag, overwrite=overwrite)

    flight = fly(chosen, checked=False, progress=True)
    if bag is not None:
        with console.progress("recording") as advance:
            bag = flight.save(bag, overwrite=overwrite, progress=advance).bag
    verdict = flight.verdict
    if picture is not None:
        flight.save_picture(picture)
    show_verdict(verdict, json=json, bag=bag, picture=picture)
    raise typer.Exit(verdict.exit_code)


def _drawn(
    context: typer.Context, scenario: str | None, sweep: Path | None, draw: int | None
) -> Scenario:
    """The scenario of a draw, with the overrides of the options."""
    from ptnsbc_sim.scenario import scenario_from_text
    from ptnsbc_sim.sweep import SweepError
    from ptnsbc_sim.sweep import draw as draw_of
    from ptnsbc_tools.sweeps.table import plan_in

    if scenario is not None or sweep is None or draw is None:
        raise SweepError("expected a SCENARIO, or --sweep DIR and --draw K")

    found = draw_of(plan_in(sweep), draw)
    given = options.overrides(**context.params)
    return scenario_from_text(found.text, given, source=found.source) if given else found
