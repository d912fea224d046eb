"""Pre-flight dry runs as findings, and the check on one screen: accepted or refused, what to change, and the plan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rich.table import Table
from rich.text import Text

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sweep.dry_run import START_M, DryFlight, DryRun, dry_run, remedies
from ptnsbc_sim.verdict.deadline import WORST_FIRST
from ptnsbc_tools import console
from ptnsbc_tools.check import CheckReport
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings
from ptnsbc_tools.check.geometry import meetings
from ptnsbc_tools.limits import DRY_RUNS
from ptnsbc_tools.sweeps.summary import share
from ptnsbc_tools.tables import came_later, findings_table

KEY = "dry run"
_DEADLINE = "gains.formation.deadline_s"
_MOST_NAMED = 3  # obstacles of a plan
_MOST_FINDINGS = 4  # at a glance


def flown(
    scenario: Scenario, runs: int = DRY_RUNS, progress: bool | None = True, *, strict: bool = False
) -> CheckReport:
    """Fly a scenario, as it stands and perturbed, with progress, and report what came of it.

    Raises:
        SweepError: UAVs start so close that no perturbed start has room.
    """
    with console.compiling(), console.progress("dry runs", progress) as advance:
        done = dry_run(scenario, runs, progress=advance)
    return CheckReport(scenario, tuple(findings(scenario, done, strict=strict)), done)


def findings(scenario: Scenario, done: DryRun, *, strict: bool = False) -> Findings:
    """The share that met, who is late, the worst flight, the least room, and what would mend it.

    `strict`: a UAV that will be late because it gives way refuses the scenario.
    """
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
    yield Finding(severity, KEY, value, limit, advice)
    if done.flights[0].late:
        value = f"{len(done.flights[0].late)} of {len(scenario.uav_ids)} UAVs in place after the deadline"
        advice = f"raise {_DEADLINE}, or start or place them farther from what they give way to"
        yield Finding(ERROR if strict else WARNING, f"{KEY}: late", value, "0", advice)
    worst, room = done.worst, done.least_room_m
    if not worst.met:
        value = f"UAV {worst.uav} {worst.verdict}"
        yield Finding(WARNING, f"{KEY}: worst", value, "met", worst.cause)
    if room is not None:
        severity, value = WARNING if room < 0.0 else INFO, f"{room:.3f} m beyond the keep-outs"
        yield Finding(severity, f"{KEY}: room", value, ">= 0 m", "")


def counts(done: DryRun) -> str:
    """The dry runs by their verdicts, in words: `19 of 21 dry runs met, 2 met late`."""
    verdicts = [flight.verdict for flight in done.flights]
    kinds = [kind for kind in reversed(WORST_FIRST) if kind in verdicts]
    first, *others = (f"{verdicts.count(kind)} {kind}" for kind in kinds)
    number, _, kind = first.partition(" ")
    return ", ".join([f"{number} of {len(verdicts)} dry runs {kind}", *others])


def _in_place(scenario: Scenario, flight: DryFlight) -> str:
    """UAVs in place by the deadline, and those that came later, with the reason."""
    by = f"by {scenario.gains.formation.deadline_s:g} s"
    if not flight.late:
        return f"{flight.in_place} of {len(scenario.uav_ids)} in place {by}"
    names = [name for row in flight.late for name in row.gave_way_to.split(",") if name]
    uavs = {f"uav{uav}" for uav in scenario.uav_ids}
    came = came_later([row.arrived_s or 0.0 for row in flight.late], names, uavs)
    return f"{flight.in_place} in place {by}, {came}"


def plan(scenario: Scenario, found: Iterable[Finding], done: DryRun | None) -> dict[str, str]:
    """The plan in a few lines: deadline or legs, the flight as it stands, and who avoids what when."""
    lines = {one.key: one.value for one in found if one.key == _DEADLINE}
    told = {"deadline": lines[_DEADLINE]} if lines else {}
    if scenario.mission is not None:
        told["legs"] = ", ".join(f"{leg.name} by {leg.due_s:g} s" for leg in scenario.legs)
    if done is not None:
        told["flown"] = _in_place(scenario, done.flights[0])
        if done.least_room_m is not None:
            told["flown"] += f"; least room {done.least_room_m:.2f} m beyond the keep-outs"
    told["avoids"] = "; ".join(_met(scenario)) or "nothing in its way after the deadline"
    return told


def _met(scenario: Scenario) -> Iterator[str]:
    """Each obstacle with those on whose way it is, the first one first."""
    uavs: dict[str, list[int]] = {}
    first_s: dict[str, float] = {}
    for meeting in sorted(meetings(scenario), key=lambda one: one.first_s):
        uavs.setdefault(meeting.obstacle.name, []).append(meeting.uav)
        first_s.setdefault(meeting.obstacle.name, meeting.first_s)
    for name in list(uavs)[:_MOST_NAMED]:
        yield f"{name} from {first_s[name]:.1f} s (UAV {', '.join(map(str, uavs[name]))})"
    if len(uavs) > _MOST_NAMED:
        yield f"{len(uavs) - _MOST_NAMED} more"


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
        if report.ok or label != "deadline":  # of a refused one the error says it
            plan.add_row(label, Text(text))
    yield plan
    if not verbose and len(report) > len(loud):
        yield Text(
            f"{len(report) - len(loud)} other findings are as they should be: -v", style="dim"
        )
