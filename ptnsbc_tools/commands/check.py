"""`ptnsbc check`: the findings as a table or as JSON."""

from __future__ import annotations

import dataclasses

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console
from ptnsbc_tools.check import ERROR, check, refuse
from ptnsbc_tools.tables import findings_table


def run(scenario: Scenario, *, json: bool) -> None:
    """Print all findings; raise when one of them is an error."""
    with console.compiling():
        findings = check(scenario)
    if json:
        console.print_json(
            {
                "scenario": scenario.name,
                "ok": all(finding.severity != ERROR for finding in findings),
                "findings": [dataclasses.asdict(finding) for finding in findings],
            }
        )
    else:
        console.out().print(findings_table(scenario.name, findings))
    refuse(scenario, findings)
