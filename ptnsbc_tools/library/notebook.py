"""The tables of flights, sweeps, checks and verdicts in a notebook: the tables of the command line."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from ptnsbc_core.errors import PtnsbcError

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario
    from ptnsbc_sim.verdict import Verdict
    from ptnsbc_tools.library.flight import Flight
    from ptnsbc_tools.library.flying import CheckReport
    from ptnsbc_tools.library.sweeping import Sweep
    from ptnsbc_tools.sweeps.comparison import SweepComparison

_WIDTH = 140
_FRAME = '<pre style="line-height:1.2;overflow-x:auto">{code}</pre>'


def html(parts: Iterable[Any]) -> str:
    """Rich tables and texts as HTML."""
    from ptnsbc_tools import console

    screen = console.recording(io.StringIO(), _WIDTH)
    for part in parts:
        screen.print(part, highlight=False, soft_wrap=isinstance(part, str))
    return screen.export_html(inline_styles=True, code_format=_FRAME)


def of_verdict(verdict: Verdict) -> str:
    """All tables and reasons of a verdict."""
    from ptnsbc_tools import tables

    return html(
        [*tables.verdict_tables(verdict), *tables.reasons(verdict), tables.verdict_line(verdict)]
    )


def of_flight(flight: Flight) -> str:
    """The deadlines of a flight, or why there is no verdict."""
    from ptnsbc_tools import tables

    try:
        verdict = flight.verdict
    except PtnsbcError as error:
        return html([f"{flight.scenario.name}: no verdict: {error}"])
    return html([tables.deadline_table(verdict), tables.verdict_line(verdict)])


def of_check(report: CheckReport) -> str:
    """The findings."""
    from ptnsbc_tools import tables

    return html([tables.findings_table(f"Pre-flight check of {report.scenario.name}", report)])


def of_sweep(sweep: Sweep) -> str:
    """All tables of a sweep."""
    from ptnsbc_tools.sweeps import summary

    return html([*summary.tables(sweep.flown), summary.line(sweep.flown)])


def of_comparison(found: SweepComparison) -> str:
    """The tables of a comparison, and its sentence."""
    from ptnsbc_tools.sweeps import comparison

    return html([*comparison.tables(found), comparison.line(found)])


def of_scenario(scenario: Scenario) -> str:
    """The file of a scenario."""
    return html([scenario.text])


_SHOWN: dict[tuple[str, str], Callable[[Any], str]] = {
    ("ptnsbc_sim.verdict.verdict", "Verdict"): of_verdict,
    ("ptnsbc_sim.scenario.scenario", "Scenario"): of_scenario,
    ("ptnsbc_tools.library.flight", "Flight"): of_flight,
    ("ptnsbc_tools.library.flying", "CheckReport"): of_check,
    ("ptnsbc_tools.library.sweeping", "Sweep"): of_sweep,
    ("ptnsbc_tools.sweeps.comparison", "SweepComparison"): of_comparison,
}


def register() -> None:
    """Show our results as tables in this notebook; nothing without one."""
    found = sys.modules.get("IPython")
    shell = None if found is None else found.get_ipython()
    if shell is not None:
        formatter = shell.display_formatter.formatters["text/html"]
        for (module, name), shown in _SHOWN.items():
            formatter.for_type_by_name(module, name, shown)
