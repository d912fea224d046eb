"""The check of a scenario on one screen: accepted or refused, what to change, and the plan."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table
from rich.text import Text

from ptnsbc_tools import console
from ptnsbc_tools.check import ERROR, INFO, CheckReport
from ptnsbc_tools.check.dry_run import counts
from ptnsbc_tools.tables import findings_table

_MOST_FINDINGS = 4  # at a glance


def check_report(report: CheckReport, *, verbose: bool = False) -> Iterator[Table | Text]:
    """The check of a scenario: accepted or refused and why, what to change, and the plan."""
    loud = [one for one in report if one.severity != INFO]
    if report.ok:
        why = "by closed forms" if report.flown is None else counts(report.flown)
        warnings = f"; {console.counted(len(loud), 'warning')}" if loud else ""
        verdict = Text.assemble(("accepted", "green"), f": {why}{warnings}")
    else:
        error = next(one for one in loud if one.severity == ERROR)
        what = f": {error.key}: {error.value.partition(';')[0]}"
        verdict = Text.assemble(("refused", "bold red"), what)
    yield Text(f"{report.scenario.name}: ") + verdict
    if verbose or loud:
        yield findings_table(report if verbose else loud[:_MOST_FINDINGS], brief=not verbose)
    if not verbose and len(loud) > _MOST_FINDINGS:
        yield Text(f"{len(loud) - _MOST_FINDINGS} more of them: -v")
    plan = Table.grid(padding=(0, 2, 0, 0))
    for label, text in report.plan.items():
        plan.add_row(label, Text(text))
    yield plan
    if not verbose and len(report) > len(loud):
        yield Text(f"{len(report) - len(loud)} findings need no change: -v", style="dim")
