"""The tables of flights, sweeps, checks and verdicts in a notebook: the tables of the command line."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable
from typing import Any

from ptnsbc_core.errors import PtnsbcError

_WIDTH = 140
_FRAME = '<pre style="line-height:1.2;overflow-x:auto">{code}</pre>'

SHOWN = (
    ("ptnsbc_sim.verdict.verdict", "Verdict"),
    ("ptnsbc_sim.scenario.scenario", "Scenario"),
    ("ptnsbc_tools.library.flight", "Flight"),
    ("ptnsbc_tools.check", "CheckReport"),
    ("ptnsbc_tools.library.sweeping", "Sweep"),
    ("ptnsbc_tools.sweeps.comparison", "SweepComparison"),
)
"""Module and name of the types that a notebook shows as tables."""


def html(result: Any) -> str:
    """A result of one of the types `SHOWN` as HTML."""
    from ptnsbc_tools import console

    screen = console.recording(io.StringIO(), _WIDTH)
    for part in _parts(result):
        screen.print(part, highlight=False, soft_wrap=isinstance(part, str))
    return screen.export_html(inline_styles=True, code_format=_FRAME)


def _parts(result: Any) -> Iterable[Any]:
    """The tables and lines that the command line prints of a result."""
    from ptnsbc_tools import tables
    from ptnsbc_tools.check.dry_run import check_report
    from ptnsbc_tools.sweeps import comparison, summary

    match type(result).__name__:
        case "Verdict":
            lines = [*tables.reasons(result), tables.verdict_sentence(result)]
            return [*tables.verdict_tables(result), *lines]
        case "Flight":
            try:
                verdict = result.verdict
            except PtnsbcError as error:
                return [f"{result.scenario.name}: no verdict: {error}"]
            return [tables.deadline_table(verdict), tables.verdict_sentence(verdict)]
        case "CheckReport":
            return check_report(result, verbose=True)
        case "Sweep":
            return [*summary.tables(result.flown), summary.line(result.flown)]
        case "SweepComparison":
            return [*comparison.tables(result), comparison.line(result)]
        case _:
            return [result.text]  # a scenario: its file


def register() -> None:
    """Show our results as tables in this notebook; nothing without one."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is not None:
        formatter = shell.display_formatter.formatters["text/html"]
        for module, name in SHOWN:
            formatter.for_type_by_name(module, name, html)
