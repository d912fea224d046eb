"""`ptnsbc check`: the pre-flight check of a scenario."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import typer

from ptnsbc_tools import console, options

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario


def check(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    json: options.JsonOption = False,
) -> None:
    """Check a scenario before anything arms: graph, shape, spacing, gains, deadline, obstacles."""
    from ptnsbc_tools.check import ERROR, check, refuse
    from ptnsbc_tools.tables import findings_table

    chosen = options.chosen(context)
    with console.compiling():
        findings = check(chosen)
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
