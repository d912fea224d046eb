"""The pre-flight check of a scenario: graph, shape, spacing, gains, deadlines, obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.check import gains, geometry, mission
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, CheckError, Finding, Findings

if TYPE_CHECKING:
    from ptnsbc_sim.sweep.dry_run import DryRun

__all__ = ["ERROR", "INFO", "WARNING", "CheckError", "CheckReport", "Finding", "check"]

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


@dataclass(frozen=True)
class CheckReport:
    """The findings of the pre-flight check, errors first."""

    scenario: Scenario = field(repr=False)
    findings: tuple[Finding, ...]
    flown: DryRun | None = field(default=None, repr=False)
    plan: Mapping[str, str] = field(default_factory=dict, repr=False)
    """In a few lines: deadline or legs, who is in place by then in the dry run, who avoids what when."""

    @property
    def ok(self) -> bool:
        """True if nothing that was found is an error."""
        return all(finding.severity != ERROR for finding in self.findings)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.findings)

    def __len__(self) -> int:
        return len(self.findings)

    def refuse(self) -> None:
        """Raise CheckError, in one line, when a finding is an error."""
        errors = [finding for finding in self.findings if finding.severity == ERROR]
        if errors:
            more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
            raise CheckError(f"{self.scenario.source}: {errors[0]}{more}")
