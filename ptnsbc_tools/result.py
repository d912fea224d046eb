"""The end of every command that flies or reads a flight: its verdict, for people or as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import check, console
from ptnsbc_tools.tables import findings_table, reasons, verdict_line, verdict_tables
from ptnsbc_tools.verdict import Verdict


def preflight(scenario: Scenario, *, quiet: bool) -> None:
    """Refuse to fly what cannot be flown; show warnings."""
    with console.compiling():
        findings = check.check(scenario)
    loud = [finding for finding in findings if finding.severity != check.INFO]
    if loud and not quiet:
        console.err().print(findings_table(scenario.name, loud))
    check.refuse(scenario, findings)


def show(verdict: Verdict, *, json: bool, extra: dict[str, Any] | None = None) -> None:
    """Print the verdict; `extra` goes into the JSON and below the tables."""
    files = {key: value for key, value in (extra or {}).items() if value is not None}
    if json:
        plain = {
            key: str(value) if isinstance(value, Path) else value for key, value in files.items()
        }
        console.print_json({**verdict.as_json(), **plain})
        return
    out = console.out()
    for table in verdict_tables(verdict):
        out.print(table)
    for line in [*reasons(verdict), verdict_line(verdict)]:
        out.print(line, soft_wrap=True)
    for key, value in files.items():
        if isinstance(value, Path):
            print(f"{key}: {value}")


def leave(verdict: Verdict) -> None:
    """End the command with the exit code of the verdict."""
    if verdict.exit_code:
        raise typer.Exit(verdict.exit_code)
