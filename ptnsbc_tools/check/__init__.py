"""The pre-flight check of a scenario: graph, shape, spacing, gains, deadlines, obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.problems import Problem
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, CheckError, Finding, Findings
from ptnsbc_tools.check.gains import (
    changes,
    feasible,
    order,
    positioning,
    printed,
    steps,
    within_flight,
)
from ptnsbc_tools.check.geometry import (
    encounters,
    graph,
    moving_spacing,
    recovery,
    sensor,
    shape,
    slots,
    spacing,
    starts_clear,
    turn,
)
from ptnsbc_tools.check.mission import faults, legs, membership, trajectory, words

__all__ = ["ERROR", "INFO", "WARNING", "CheckError", "Finding", "check", "refuse"]

_CHECKS: Sequence[Callable[[Scenario], Findings]] = (
    graph,
    shape,
    spacing,
    moving_spacing,
    starts_clear,
    steps,
    order,
    printed,
    slots,
    turn,
    feasible,
    within_flight,
    changes,
    legs,
    words,
    membership,
    trajectory,
    encounters,
    recovery,
    sensor,
    positioning,
    faults,
)


def check(scenario: Scenario) -> list[Finding]:
    """All findings, errors first."""
    findings = [finding for one in _CHECKS for finding in one(scenario)]
    rank = {ERROR: 0, WARNING: 1, INFO: 2}
    return sorted(findings, key=lambda finding: rank[finding.severity])


def refuse(scenario: Scenario, findings: Sequence[Finding]) -> None:
    """Raise CheckError, in one line, when any finding is an error."""
    errors = [finding for finding in findings if finding.severity == ERROR]
    if errors:
        first = errors[0]
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        problem = Problem(first.key, first.value, first.limit, first.advice)
        raise CheckError(f"{scenario.source}: {problem}{more}")
