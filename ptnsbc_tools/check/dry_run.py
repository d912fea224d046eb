"""Pre-flight dry runs as findings: the share that met, the worst flight, and what would mend it."""

from __future__ import annotations

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sweep.dry_run import START_M, dry_run, remedies
from ptnsbc_tools import console
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding
from ptnsbc_tools.limits import DRY_RUNS
from ptnsbc_tools.sweeps.summary import share

KEY = "dry run"


def flown(scenario: Scenario, runs: int = DRY_RUNS, progress: bool | None = True) -> list[Finding]:
    """Fly a scenario, as it stands and perturbed, with progress, and say what came of it.

    Raises:
        SweepError: UAVs start so close that no perturbed start has room.
    """
    with console.compiling(), console.progress("dry runs", progress) as advance:
        done = dry_run(scenario, runs, progress=advance)
    of = len(done.flights)
    accepted = done.accepted()
    first = "" if done.flights[0].met else "; the unperturbed flight is not met"
    advice = ""
    if not accepted:
        mended = [remedy.said for remedy in remedies(scenario)]
        advice = "; or ".join(mended) or (
            "no longer deadline, other task, graph or avoidance mended it: move starts or places apart"
        )
    severity = ERROR if not accepted else WARNING if done.met < of else INFO
    value = f"{share(done.met, of)} met; starts moved by {START_M:g} m{first}"
    limit = f">= {100 * done.least:g} %, and the unperturbed flight"
    findings = [Finding(severity, KEY, value, limit, advice)]
    worst, room = done.worst, done.least_room_m
    if not worst.met:
        value = f"UAV {worst.uav} {worst.verdict}"
        findings.append(Finding(WARNING, f"{KEY}: worst", value, "met", worst.cause))
    if room is not None:
        severity, value = WARNING if room < 0.0 else INFO, f"{room:.3f} m beyond the keep-outs"
        findings.append(Finding(severity, f"{KEY}: room", value, ">= 0 m", ""))
    return findings
