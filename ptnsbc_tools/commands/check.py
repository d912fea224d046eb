"""`ptnsbc check`: the pre-flight check of a scenario, by closed forms and by dry runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario
    from ptnsbc_tools.check import Finding

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
    backend: Annotated[
        Literal["sim", "mavlink"],
        typer.Option("--backend", help="Check what the fleet flies with this backend."),
    ] = "sim",
    fly: Annotated[
        bool, typer.Option("--fly/--no-fly", help="Fly dry runs when the rest finds no error.")
    ] = True,
    runs: Annotated[
        int, typer.Option("--runs", "-n", metavar="N", min=1, help="Perturbed dry runs.")
    ] = _RUNS,
    json: options.JsonOption = False,
) -> None:
    """Check a scenario before anything arms: graph, shape, spacing, gains, deadline, obstacles, dry runs.

    The dry runs fly the scenario in this process: once as it stands, then with starts moved at random.
    The scenario is refused when the first of them is not met, or fewer than half of all.
    """
    from ptnsbc_tools.check import ERROR, check, refuse
    from ptnsbc_tools.tables import findings_table

    chosen = options.chosen(context)
    if backend == "mavlink":
        chosen = chosen.bridged()
    with console.compiling():
        findings = check(chosen)
    if fly and all(finding.severity != ERROR for finding in findings):
        findings = [*dry_runs(chosen, runs), *findings]
    if json:
        console.print_json(
            {
                "scenario": chosen.name,
                "ok": all(finding.severity != ERROR for finding in findings),
                "findings": [dataclasses.asdict(finding) for finding in findings],
            }
        )
    else:
        console.out().print(findings_table(chosen.name, findings))
    refuse(chosen, findings)


def dry_runs(scenario: Scenario, runs: int = _RUNS) -> Sequence[Finding]:
    """The findings of dry runs, with progress when they take longer than a moment."""
    from ptnsbc_tools.check.dry_run import flown

    with console.compiling(), console.progress("dry runs") as advance:
        return flown(scenario, runs, advance)


def preflight(scenario: Scenario, *, quiet: bool, refusing: bool = True) -> None:
    """Check a scenario before a flight: show warnings, and raise on errors where `refusing`."""
    from ptnsbc_tools.check import INFO, check, refuse
    from ptnsbc_tools.tables import findings_table

    with console.compiling():
        findings = check(scenario)
    warnings = [finding for finding in findings if finding.severity != INFO]
    if warnings and not quiet:
        console.err().print(findings_table(scenario.name, warnings))
    if refusing:
        refuse(scenario, findings)
