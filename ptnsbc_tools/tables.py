"""Findings and verdicts for people: Rich tables and sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from ptnsbc_sim.verdict import Verdict
from ptnsbc_sim.verdict.deadline import WORST_FIRST
from ptnsbc_tools import console
from ptnsbc_tools.check.finding import Finding

_COLOURS = {
    "error": "bold red",
    "warning": "yellow",
    "info": "dim",
    "missed": "bold red",
    "violated": "bold red",
    "void": "yellow",
    "cut short": "yellow",
    "met late": "yellow",
    "met": "green",
}
_PAIRS = 3

# Heading, attribute and digits of each column of numbers
_Columns = tuple[tuple[str, str, int], ...]
_SLOT = ("slot", "slot", 0)
_DEADLINE: _Columns = (
    ("settled s", "settling_s", 2),
    ("of s", "deadline_s", 2),
    ("start m", "start_error_m", 3),
    ("band m", "band_m", 3),
    ("at tf m", "error_at_deadline_m", 4),
    ("max after m", "max_error_after_m", 4),
    ("with excused m", "max_error_after_all_m", 4),
    ("RMSE m", "rmse_after_m", 4),
    ("excused s", "encounter_s", 1),
)
_REGAINED: _Columns = (("back after s", "regained_s", 2), ("of s", "recovery_s", 2))
_MISSING: _Columns = (("missing", "missing", 0),)
_EFFORT: _Columns = (
    ("above hover at t0 N", "initial_above_hover_n", 2),
    ("peak |u|", "peak_input", 2),
    ("peak force N", "peak_force_n", 2),
    ("at s", "peak_at_s", 2),
    ("energy (54)", "energy", 0),
    ("beyond hover", "energy_above_hover", 1),
    ("missing", "missing", 0),
)
_CHANGES: _Columns = (("due s", "due_s", 2), ("largest error m", "error_m", 4))
_LEGS: _Columns = (("begins s", "begin_s", 2), *_CHANGES, ("of UAV", "uav", 0))
_SEPARATION: _Columns = (
    ("closest m", "distance_m", 4),
    ("at s", "at_s", 2),
    ("keep-out m", "keep_out_m", 2),
    ("inside s", "inside_s", 2),
)


def _numbers(of: object, columns: _Columns) -> list[str]:
    values = ((getattr(of, name), digits) for _, name, digits in columns)
    return ["-" if value is None else f"{value:.{digits}f}" for value, digits in values]


def _table(title: str, left: Iterable[str], right: _Columns = ()) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for name in left:
        table.add_column(name, overflow="fold")
    for name, _, _ in right:
        table.add_column(name, justify="right")
    return table


def word(kind: str) -> Text:
    """A verdict or a severity in its colour."""
    return Text(kind, style=_COLOURS[kind])


def findings_table(findings: Iterable[Finding], *, brief: bool = False) -> Table:
    """Findings, the worst first: what was found, its limit, and what to change; `brief`: that or the limit."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column()
    table.add_column(overflow="fold", ratio=1)
    for one in findings:
        text = Text(f"{one.key}: {one.value}")
        if one.limit and not (brief and one.advice):
            text.append(f"\nexpected: {one.limit}", style="dim")
        if one.advice:
            text.append(f"\nchange: {one.advice}")
        table.add_row(word(one.severity), text)
    return table


def deadline_table(verdict: Verdict) -> Table:
    """One row per UAV: whether it met its deadline and kept its distances."""
    title = f"{verdict.scenario}: {verdict.plant}, {verdict.task}, profile {verdict.profile}"
    own = all(one.slot == one.uav for one in verdict.uavs)
    columns = _DEADLINE if own else (_SLOT, *_DEADLINE)
    columns += _MISSING if any(one.missing for one in verdict.uavs) else ()
    table = _table(title, ("UAV", "verdict"), columns)
    for one in verdict.uavs:
        table.add_row(str(one.uav), word(one.verdict), *_numbers(one, columns))
    return table


def _change_table(verdict: Verdict) -> Table | None:
    """One row per leg of the mission, or per change of the shape that was due: the worst UAV."""
    if verdict.mission:
        table = _table("Legs of the mission", ("leg", "kind", "verdict"), _LEGS)
        for leg in verdict.mission:
            table.add_row(leg.name, leg.kind, word(leg.verdict), *_numbers(leg, _LEGS))
        return table
    uavs = [uav for leg in verdict.legs for uav in leg.uavs]
    reached = [(of.uav, due) for of in uavs for due in of.changes if due.error_m is not None]
    if not reached:
        return None
    table = _table("Changes of the shape", ("change",), _CHANGES)
    table.add_column("of UAV", justify="right")
    for number in sorted({due.number for _, due in reached}):
        of_change = [(uav, due) for uav, due in reached if due.number == number]
        uav, worst = max(of_change, key=lambda of: of[1].error_m or 0.0)
        table.add_row(str(number), *_numbers(worst, _CHANGES), str(uav))
    return table


def mission_list(found: Mapping[str, Any]) -> Table:
    """The legs of a flying fleet, from the answer of its leader."""
    now_s = found["now_s"]
    title = "Legs" if now_s is None else f"Legs, {now_s:.1f} s after the first epoch"
    table = _table(title, ("leg", "kind", "state"), (("begins s", "", 2), ("due s", "", 2)))
    for one in found["legs"]:
        begin_s, due_s = one.get("begin_s"), one.get("due_s")
        state = "waits for a word"
        if begin_s is not None:
            begun = now_s is not None and begin_s <= now_s
            state = "to come" if not begun else "begun" if now_s < one["end_s"] else "done"
        times = ("-" if time is None else f"{time:.2f}" for time in (begin_s, due_s))
        number = f"{one['number']} " if one["number"] else ""
        table.add_row(f"{number}{one['name']}", one["kind"], state, *times)
    return table


def verdict_tables(verdict: Verdict) -> list[Table]:
    """All tables of a verdict: deadlines, input, and the tightest pairs with all that were inside a keep-out."""
    tables = [deadline_table(verdict)]
    regained = [uav for uav in verdict.uavs if uav.regained_s is not None]
    if regained:
        tables.append(back := _table("Way back after encounters", ("UAV",), _REGAINED))
        for of in regained:
            back.add_row(str(of.uav), *_numbers(of, _REGAINED))
    if changes := _change_table(verdict):
        tables.append(changes)
    if verdict.efforts:
        tables.append(effort := _table("Input", ("UAV",), _EFFORT))
        for one in verdict.efforts:
            effort.add_row(str(one.uav), *_numbers(one, _EFFORT))
    if verdict.separations:
        tables.append(separation := _table("Separation", ("pair",), _SEPARATION))
        for rank, pair in enumerate(verdict.separations):
            if rank < _PAIRS or pair.entered:
                colour = "bold red" if pair.entered else ""
                cells = _numbers(pair, _SEPARATION)
                separation.add_row(f"{pair.first} - {pair.second}", *cells, style=colour)
    return tables


def reasons(verdict: Verdict) -> list[Text]:
    """The injected faults, why UAVs are not met, and the encounters that excuse met ones: one line each."""
    found = [Text(f"injected: {fault}") for fault in verdict.faults]
    for leg in verdict.legs:
        of_leg = f"leg {leg.number} from {leg.epoch_s - verdict.epoch_s:.2f} s, "
        where = of_leg if len(verdict.legs) > 1 else ""
        if leg.reason:
            found.append(Text.assemble(where, word(leg.verdict), f": {leg.reason}"))
        found += [
            Text.assemble(where, f"UAV {one.uav} ", word(one.verdict), f": {text}")
            for one in leg.uavs
            if (text := one.reason or one.excuse)
        ]
    return found + [
        Text.assemble(f"leg {leg.name} ", word(leg.verdict), f": {leg.reason}")
        for leg in verdict.mission
        if leg.reason
    ]


def verdict_line(verdict: Verdict) -> Text:
    """The last line: the verdict in a sentence."""
    judged = [one.verdict for leg in verdict.legs for one in leg.uavs]
    counts = {kind: judged.count(kind) for kind in _COLOURS}
    parts = [f"{counts[kind]} {kind}" for kind in reversed(WORST_FIRST) if counts[kind]]
    tail = f"deadline {verdict.uavs[0].deadline_s:g} s: {', '.join(parts)}"
    if len(verdict.legs) > 1:
        tail += f" in {len(verdict.legs)} legs"
    if verdict.judged_by == "truth":
        tail += "; judged by true positions"
    if any(pair.entered for pair in verdict.separations):
        tail += f"; inside a keep-out for {verdict.inside_keep_out_s:.2f} s"
    excused = sum(one.excused_outside_s for leg in verdict.legs for one in leg.uavs)
    if excused:
        tail += f"; {excused:.2f} s outside the band excused near objects"
    missing = sum(one.missing for one in verdict.uavs)
    missing += sum(one.missing for one in verdict.efforts)
    if missing:
        tail += f"; {console.counted(missing, 'message')} missing"
    if verdict.missed_ticks:
        tail += f"; {console.counted(verdict.missed_ticks, 'tick')} missed"
    if verdict.latency_ms:
        figures = ", ".join(f"{key} {value:.1f} ms" for key, value in verdict.latency_ms.items())
        tail += f"; latency {figures}"
    return Text.assemble("Verdict: ", word(verdict.verdict), f" ({tail})")


def show_verdict(verdict: Verdict, *, json: bool, **extra: Any) -> None:
    """Print the verdict as tables or as JSON; `extra` goes into the JSON, and its paths below the tables."""
    files = {key: value for key, value in extra.items() if value is not None}
    if json:
        plain = {
            key: str(value) if isinstance(value, Path) else value for key, value in files.items()
        }
        console.print_json({**verdict.as_json(), **plain})
        return
    out = console.out()
    for table in verdict_tables(verdict):
        for part in console.narrowed(table, out):
            out.print(part)
    for line in [*reasons(verdict), verdict_line(verdict)]:
        out.print(line, soft_wrap=True)
    for key, value in files.items():
        if isinstance(value, Path):
            print(f"{key}: {value}")
