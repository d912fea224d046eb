"""`ptnsbc check`: the pre-flight check of a scenario, by closed forms and by dry runs."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ptnsbc_tools import console, options
from ptnsbc_tools.limits import MOST_RUNS

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario

_RUNS = 20


def check(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    mission: options.MissionOption = None,
    backend: Annotated[
        Literal["sim", "mavlink"],
        typer.Option("--backend", help="Check what the fleet flies with this backend."),
    ] = "sim",
    fly: Annotated[
        bool, typer.Option("--fly/--no-fly", help="Fly dry runs when the rest finds no error.")
    ] = True,
    runs: Annotated[
        int,
        typer.Option("--runs", "-n", metavar="N", min=1, max=MOST_RUNS, help="Perturbed dry runs."),
    ] = _RUNS,
    json: options.JsonOption = False,
) -> None:
    """Check a scenario before anything arms: graph, shape, spacing, gains, deadline, obstacles, dry runs.

    The dry runs fly the scenario in this process: once as it stands, then with starts moved at random.
    The scenario is refused when the first of them is not met, or fewer than half of all; with noise, gusts, faults
    or lossy links, fewer than 95 % of all.
    """
    from ptnsbc_tools.library import flying
    from ptnsbc_tools.tables import findings_table

    chosen = options.chosen(context)
    if backend == "mavlink":
        chosen = chosen.bridged()
    found = flying.check(chosen, dry_runs=runs if fly else 0, progress=True)
    if json:
        console.print_json(
            {
                "scenario": chosen.name,
                "ok": found.ok,
                "findings": [dataclasses.asdict(finding) for finding in found],
            }
        )
    else:
        console.out().print(findings_table(f"Pre-flight check of {chosen.name}", found))
    found.refuse()


def preflight(scenario: Scenario, *, quiet: bool, refusing: bool = True) -> None:
    """Check a scenario before a flight: show warnings, and raise on errors where `refusing`."""
    from ptnsbc_tools.check import INFO
    from ptnsbc_tools.library import flying
    from ptnsbc_tools.tables import findings_table

    found = flying.check(scenario, dry_runs=0)
    warnings = [finding for finding in found if finding.severity != INFO]
    if warnings and not quiet:
        console.err().print(findings_table(f"Pre-flight check of {scenario.name}", warnings))
    if refusing:
        found.refuse()
