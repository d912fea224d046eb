"""Findings and verdicts as tables for people."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table
from rich.text import Text

from ptnsbc_tools.check import Finding
from ptnsbc_tools.verdict import Verdict

_COLOURS = {
    "error": "bold red",
    "warning": "yellow",
    "info": "dim",
    "missed": "bold red",
    "void": "yellow",
    "met": "green",
}
_PAIRS = 3


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _table(title: str, left: Iterable[str], right: Iterable[str]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for name in left:
        table.add_column(name, overflow="fold")
    for name in right:
        table.add_column(name, justify="right")
    return table


def _word(kind: str) -> Text:
    return Text(kind, style=_COLOURS[kind])


def findings_table(name: str, findings: Iterable[Finding]) -> Table:
    """The pre-flight check, worst first."""
    table = _table(f"Pre-flight check of {name}", ("", "key", "found", "limit", "change"), ())
    for one in findings:
        table.add_row(_word(one.severity), one.key, one.value, one.limit, one.advice)
    return table


def deadline_table(verdict: Verdict) -> Table:
    """One row per UAV: did it keep its deadline."""
    title = f"{verdict.scenario}: {verdict.plant}, {verdict.task}, profile {verdict.profile}"
    table = _table(
        title,
        ("UAV", "deadline"),
        (
            "settled s",
            "of s",
            "start m",
            "band m",
            "at tf m",
            "max after m",
            "RMSE after m",
            "avoiding s",
            "missing",
        ),
    )
    for one in verdict.uavs:
        table.add_row(
            str(one.uav),
            _word(one.verdict),
            _number(one.settling_s, 2),
            _number(one.deadline_s, 2),
            _number(one.start_error_m),
            _number(one.band_m),
            _number(one.error_at_deadline_m, 4),
            _number(one.max_error_after_m, 4),
            _number(one.rmse_after_m, 4),
            _number(one.encounter_s, 1),
            str(one.missing),
        )
    return table


def effort_table(verdict: Verdict) -> Table:
    """One row per UAV: what the actuators had to give."""
    table = _table(
        "Input",
        ("UAV",),
        (
            "above hover at t0 N",
            "peak |u|",
            "peak force N",
            "at s",
            "energy (54)",
            "beyond hover",
            "missing",
        ),
    )
    for one in verdict.efforts:
        table.add_row(
            str(one.uav),
            _number(one.initial_above_hover_n, 2),
            _number(one.peak_input, 2),
            _number(one.peak_force_n, 2),
            _number(one.peak_at_s, 2),
            _number(one.energy, 0),
            _number(one.energy_above_hover, 1),
            str(one.missing),
        )
    return table


def separation_table(verdict: Verdict) -> Table:
    """The tightest pairs, and every one that was inside a keep-out."""
    table = _table("Separation", ("pair",), ("closest m", "at s", "keep-out m", "inside s"))
    for rank, one in enumerate(verdict.separations):
        if rank >= _PAIRS and one.inside_s == 0:
            continue
        colour = "bold red" if one.inside_s > 0 else ""
        table.add_row(
            f"{one.first} - {one.second}",
            _number(one.distance_m, 4),
            _number(one.at_s, 2),
            _number(one.keep_out_m, 2),
            _number(one.inside_s, 2),
            style=colour,
        )
    return table


def verdict_tables(verdict: Verdict) -> list[Table]:
    """All tables of a verdict."""
    tables = [deadline_table(verdict)]
    if verdict.efforts:
        tables.append(effort_table(verdict))
    if verdict.separations:
        tables.append(separation_table(verdict))
    return tables


def reasons(verdict: Verdict) -> list[Text]:
    """Why deadlines were not met, one line per UAV, and per leg when there are several."""
    found = []
    for leg in verdict.legs:
        of_leg = f"leg {leg.number} from {leg.epoch_s - verdict.epoch_s:.2f} s, "
        where = of_leg if len(verdict.legs) > 1 else ""
        if leg.reason:
            found.append(Text.assemble(where, _word(leg.verdict), f": {leg.reason}"))
        found += [
            Text.assemble(where, f"UAV {one.uav} ", _word(one.verdict), f": {one.reason}")
            for one in leg.uavs
            if one.reason
        ]
    return found


def verdict_line(verdict: Verdict) -> Text:
    """The last line: the verdict in a sentence."""
    judged = [one.verdict for leg in verdict.legs for one in leg.uavs]
    counts = {kind: judged.count(kind) for kind in _COLOURS}
    parts = [f"{counts[kind]} {kind}" for kind in ("met", "void", "missed") if counts[kind]]
    tail = f"deadline {verdict.uavs[0].deadline_s:g} s: {', '.join(parts)}"
    if len(verdict.legs) > 1:
        tail += f" in {len(verdict.legs)} legs"
    if verdict.judged_by == "truth":
        tail += "; judged by true positions"
    if verdict.inside_keep_out_s > 0:
        tail += f"; inside a keep-out for {verdict.inside_keep_out_s:.2f} s"
    missing = sum(uav.missing for uav in verdict.uavs)
    missing += sum(effort.missing for effort in verdict.efforts)
    if missing:
        tail += f"; {missing} messages missing"
    if verdict.missed_ticks:
        tail += f"; {verdict.missed_ticks} ticks missed"
    if verdict.latency_ms:
        figures = ", ".join(f"{key} {value:.1f} ms" for key, value in verdict.latency_ms.items())
        tail += f"; latency {figures}"
    return Text.assemble("Verdict: ", _word(verdict.verdict), f" ({tail})")
