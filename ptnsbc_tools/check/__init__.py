"""The pre-flight check of a scenario: graph, shape, spacing, gains, deadlines, obstacles."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.check import gains, geometry, mission
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, CheckError, Finding, Findings

__all__ = ["ERROR", "INFO", "WARNING", "CheckError", "Finding", "check", "refuse"]

_CHECKS: Sequence[Callable[[Scenario], Findings]] = (
    *(geometry.graph, geometry.shape, geometry.spacing, geometry.moving_spacing),
    *(geometry.starts_clear, gains.steps, gains.order, gains.printed),
    *(geometry.slots, geometry.turn, gains.feasible, gains.within_flight, gains.changes),
    *(mission.legs, mission.words, mission.membership, mission.trajectory),
    *(geometry.encounters, geometry.recovery, geometry.sensor, gains.positioning, mission.faults),
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
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        raise CheckError(f"{scenario.source}: {errors[0]}{more}")
