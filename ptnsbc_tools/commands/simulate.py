"""`ptnsbc simulate`: the whole swarm in this process, and its verdict."""

from __future__ import annotations

import typer

from ptnsbc_tools import console, options
from ptnsbc_tools.commands.check import preflight


def simulate(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    seed: options.SeedOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    bag: options.BagOption = None,
    overwrite: options.OverwriteOption = False,
    json: options.JsonOption = False,
) -> None:
    """Fly a scenario in this process, without ROS, as fast as possible; ends with the verdict."""
    from ptnsbc_sim.scenario import scenario_from_text
    from ptnsbc_sim.verdict import verdict_on
    from ptnsbc_sim.verdict.headless import recording_of
    from ptnsbc_tools.reading.headless import prepare_bag, write_flight
    from ptnsbc_tools.tables import show_verdict

    chosen = options.chosen(context)
    preflight(chosen, quiet=json)
    if bag is not None:
        prepare_bag(bag, overwrite=overwrite)

    from ptnsbc_sim.swarm import fly  # compiles for seconds: only after all checks

    one_tick = {"timing.duration_s": 1 / chosen.control_hz}
    with console.compiling():  # the flight's own progress would stand still for a minute
        fly(scenario_from_text(chosen.text, one_tick, source=chosen.source))
    with console.progress("flying") as advance:
        flight = fly(chosen, advance)
    if bag is not None:
        with console.progress("recording") as advance:
            bag = write_flight(flight, bag, overwrite=overwrite, progress=advance)
    verdict = verdict_on(recording_of(flight))
    show_verdict(verdict, json=json, bag=bag)
    raise typer.Exit(verdict.exit_code)
