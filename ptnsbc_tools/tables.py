"""Findings and verdicts for people: Rich tables and sentences."""

from __future__ import annotations

import shlex
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from ptnsbc_sim.verdict import Verdict
from ptnsbc_sim.verdict.deadline import KEPT, MET, VOID, UavVerdict
from ptnsbc_sim.verdict.encounters import listed
from ptnsbc_sim.verdict.separation import Separation
from ptnsbc_sim.verdict.verdict import LegVerdict
from ptnsbc_tools import console, ros
from ptnsbc_tools.check.finding import INFO, Finding
from ptnsbc_tools.options import Showing

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
_NEAREST = 6
_WIDTH, _WIDEST = 80, 140
_WORDS = ("", "cause", "unit", "all UAVs", "each flight", "95 % interval")
"""Headings of columns that hold no numbers."""

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
_PLACE: _Columns = (
    ("in place after s", "settling_s", 2),
    ("worst after, m", "max_error_after_all_m", 3),
)
_SEPARATION: _Columns = (
    ("closest m", "distance_m", 3),
    ("to be kept m", "keep_out_m", 2),
    ("at s", "at_s", 2),
    ("inside s", "inside_s", 2),
)


def _numbers(of: object, columns: _Columns) -> list[str]:
    values = ((getattr(of, name), digits) for _, name, digits in columns)
    return ["-" if value is None else f"{value:.{digits}f}" for value, digits in values]


def new_table(title: str, heads: Iterable[str], words: Container[str] = _WORDS) -> Table:
    """A table without rows; all columns but `words` are numbers."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for head in heads:
        table.add_column(head, justify="left" if head in words else "right", overflow="fold")
    return table


def _table(title: str, left: Sequence[str], right: _Columns = ()) -> Table:
    return new_table(title, (*left, *(name for name, _, _ in right)), left)


@dataclass(frozen=True, repr=False)
class Summary:
    """Figures in rows: for people by `print`, for pandas, and for LaTeX."""

    title: str
    rows: tuple[Mapping[str, Any], ...]
    """The columns are the keys, the same in every row; None or NaN: there is no such figure."""

    def to_pandas(self) -> Any:
        """The rows as a pandas DataFrame."""
        return ros.library("pandas", "to_pandas()").DataFrame(self.rows)

    def to_latex(self) -> str:
        """The rows as LaTeX, for the package booktabs; what LaTeX would read as a command is escaped."""
        ros.library("jinja2", "to_latex()")
        frame = self.to_pandas()
        return str(frame.to_latex(index=False, escape=True, float_format="%.4g", na_rep="-"))

    def table(self) -> Table:
        """The rows for a terminal."""
        first = self.rows[0] if self.rows else {}
        words = [head for head, value in first.items() if isinstance(value, str)]
        table = new_table(self.title, first, words)
        for row in self.rows:
            table.add_row(*map(_cell, row.values()))
        return table

    def __repr__(self) -> str:
        shown = console.recording(StringIO(), _WIDEST)
        shown.print(self.table())
        return shown.export_text()


def _cell(value: Any) -> str:
    if value is None or value != value:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


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
            text.append(f"\n{'' if one.severity == INFO else 'change: '}{one.advice}")
        table.add_row(word(one.severity), text)
    return table


def verdict_summary(verdict: Verdict, uavs: Sequence[UavVerdict] | None = None) -> Summary:
    """The figures of each UAV, of all of the verdict or of these: its deadline, and what was kept after it."""
    uavs = verdict.uavs if uavs is None else uavs
    own = all(one.slot == one.uav for one in uavs)
    columns = _DEADLINE if own else (_SLOT, *_DEADLINE)
    columns += _MISSING if any(one.missing for one in uavs) else ()
    rows = (
        {"UAV": one.uav, "verdict": one.verdict}
        | {head: getattr(one, name) for head, name, _ in columns}
        for one in uavs
    )
    title = f"{verdict.scenario}: {verdict.plant}, {verdict.task}, profile {verdict.profile}"
    return Summary(title, tuple(rows))


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


def _place_table(leg: LegVerdict) -> Table:
    """One row per UAV: when it was in place, how far off at the deadline and after it, and the verdict."""
    at_s = f"at {leg.uavs[0].deadline_s:.4g} s, m"
    columns = (*_PLACE[:1], (at_s, "error_at_deadline_m", 3), *_PLACE[1:])
    table = _table("", ("UAV",), columns)
    table.add_column("verdict", overflow="fold")
    for of in leg.uavs:
        cells, state = _numbers(of, columns), word(of.verdict)
        if of.arrived_s is not None:
            cells[0] = f"{of.arrived_s:.2f}"
        if of.gave_way_to:
            state.append(f" ({listed(of.gave_way_to)})", style="default")
        table.add_row(str(of.uav), *cells, state)
    return table


def _separation_table(verdict: Verdict, most: int | None = None) -> Table:
    """The closest pair of UAVs, the closest UAV of each obstacle, and all that were inside a keep-out."""
    uavs = {f"uav{of.uav}" for of in verdict.uavs}
    nearest: dict[str, Separation] = {}  # the tightest come first
    for pair in verdict.separations:
        nearest.setdefault("" if pair.second in uavs else pair.second, pair)
    rows = sorted(nearest.values(), key=lambda pair: pair.second not in uavs)
    rows += [pair for pair in verdict.separations if pair.entered and pair not in rows]
    table = _table("Separation", ("pair",), _SEPARATION)
    for pair in rows[:most]:
        style = "bold red" if pair.entered else ""
        table.add_row(listed((pair.first, pair.second)), *_numbers(pair, _SEPARATION), style=style)
    if (more := len(rows) - len(rows[:most])) > 0:
        table.add_row(f"{more} more: -v")
    return table


def length(metres: float) -> str:
    """A length in m, a small one in mm."""
    return f"{metres:.2f} m" if metres >= 0.1 else f"{1000.0 * metres:.2g} mm"


def came_later(arrived_s: Sequence[float], gave_way_to: Iterable[str], uavs: Container[str]) -> str:
    """UAVs that came later than the deadline, in words: to what or whom they gave way, and when the last one came."""
    many = len(arrived_s) > 1
    names = dict.fromkeys("each other" if many and to in uavs else to for to in gave_way_to)
    who = "they" if many else "it"
    why = f"{who} gave way to {listed(names)}" if names else "others came or went"
    return f"{len(arrived_s)} later because {why}, the last at {max(arrived_s):.1f} s"


def who_came(leg: LegVerdict) -> str:
    """The UAVs that were in place at the deadline of a leg, and why others came later, in words."""
    if leg.reason:
        return f"{leg.reason}."
    there, deadline_s = leg.in_place, leg.uavs[0].deadline_s
    if there.count == there.of:
        placed = [of for of in leg.uavs if of.in_place]
        worst = max(
            ((of.error_at_deadline_m or 0.0, of.tolerance_m) for of in placed), default=(0.0, 0.0)
        )
        shown = f"worst {length(worst[0])} off ({length(worst[1])} allowed)"
        return f"In formation at {deadline_s:.4g} s: {there.count} of {there.of}, {shown}."
    text = f"{there.count} of {there.of} in place by {deadline_s:.4g} s"
    late = [of for of in leg.uavs if of.arrived_s is not None]
    if late:
        uavs = {f"uav{of.uav}" for of in leg.uavs}
        names = [name for of in late for name in of.gave_way_to]
        text += f", {came_later([of.arrived_s or 0.0 for of in late], names, uavs)}"
    return f"{text}."


def verdict_sentence(verdict: Verdict) -> Text:
    """The verdict in words: who was in place at the deadline and who came later, and how near UAVs came to what."""
    legs = verdict.legs
    parts = [who_came(legs[0])]
    parts += [
        f"Leg {leg.number}, from {leg.epoch_s - verdict.epoch_s:g} s: {who_came(leg)}"
        for leg in legs[1:]
        if leg.verdict != MET
    ]
    for name, of_name in (("legs", legs), ("legs of the mission", verdict.mission)):
        if len(of_name) > 1:
            met = sum(leg.verdict == MET for leg in of_name)
            parts.append(f"{met} of {len(of_name)} {name} met.")
    if verdict.separations:
        near = verdict.separations[0]
        pair = listed((near.first, near.second))
        parts.append(
            f"Nearest: {pair}, {near.distance_m:.2f} m ({near.keep_out_m:.2f} to be kept)."
        )
    uavs = [of for leg in legs for of in leg.uavs if of.arrived_s is None and not of.membership]
    away = [of for of in uavs if of.excused_outside_s]
    if away:
        count = console.counted(len({of.uav for of in away}), "UAV")
        off_m = max(of.max_error_after_all_m or 0.0 for of in away)
        back_s = max(of.regained_s or 0.0 for of in away)
        parts.append(
            f"{count} gave way later, or followed one that did: {length(off_m)} off, "
            f"back {back_s:.1f} s after the encounter, at most."
        )
    if verdict.inside_keep_out_s:
        parts.append(f"Inside keep-outs for {verdict.inside_keep_out_s:.2f} s.")
    missing = sum(of.missing for of in verdict.uavs) + sum(of.missing for of in verdict.efforts)
    if missing:
        parts.append(f"{console.counted(missing, 'message')} missing.")
    if verdict.missed_ticks:
        advice = ": give this computer less work, and fly again" if verdict.verdict == VOID else ""
        parts.append(f"{console.counted(verdict.missed_ticks, 'tick')} missed{advice}.")
    if verdict.latency_ms:
        figures = ", ".join(f"{key} {value:.1f} ms" for key, value in verdict.latency_ms.items())
        parts.append(f"Latency {figures}.")
    if verdict.judged_by == "truth":
        parts.append("Judged by true positions.")
    return Text.assemble("Verdict: ", word(verdict.verdict), f". {' '.join(parts)}")


def verdict_tables(verdict: Verdict) -> list[Table]:
    """All tables of a verdict: deadlines, input, and the least distances."""
    tables = [verdict_summary(verdict).table()]
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
        tables.append(_separation_table(verdict))
    return tables


def reasons(verdict: Verdict, *, all_of_them: bool = True) -> list[Text]:
    """The faults, and why UAVs and legs are not met, one line each; of all the excuses of the others too."""
    found = [Text(f"fault: {fault}") for fault in verdict.faults]
    for leg in verdict.legs:
        of_leg = f"leg {leg.number} from {leg.epoch_s - verdict.epoch_s:.2f} s, "
        where = of_leg if len(verdict.legs) > 1 else ""
        if leg.reason:
            found.append(Text.assemble(where, word(leg.verdict), f": {leg.reason}"))
        found += [
            Text.assemble(where, f"UAV {one.uav} ", word(one.verdict), f": {text}")
            for one in leg.uavs
            if (text := one.reason or one.excuse) and (all_of_them or one.verdict not in KEPT)
        ]
    return found + [
        Text.assemble(f"leg {leg.name} ", word(leg.verdict), f": {leg.reason}")
        for leg in verdict.mission
        if leg.reason
    ]


def print_plain(table: Table) -> None:
    """Print a table of the first screen: a line under its heads, and no title."""
    out = console.out()
    table.title, table.box, table.show_edge, table.pad_edge = None, SIMPLE_HEAD, False, False
    out.print("", table, sep="\n", width=min(out.width, _WIDTH))


def show_verdict(verdict: Verdict, showing: Showing, **extra: Any) -> int:
    """Print the verdict, and return the exit code; `extra` goes into the JSON, and its paths below the tables."""
    verdict = verdict.strict() if showing.strict else verdict
    files = {key: value for key, value in extra.items() if value is not None}
    if showing.json:
        plain = {
            key: str(value) if isinstance(value, Path) else value for key, value in files.items()
        }
        console.print_json({**verdict.as_json(), **plain})
        return verdict.exit_code
    out = console.out()
    for line in verdict_sentence(verdict).wrap(out, _WIDTH):
        out.print(line)
    tables = [_place_table(leg) for leg in verdict.legs if leg.uavs]
    if verdict.separations and not showing.verbose:
        tables.append(_separation_table(verdict, _NEAREST))
    for table in tables:
        print_plain(table)
    out.print()
    if showing.verbose:
        for table in verdict_tables(verdict):
            out.print(*console.narrowed(table, out), sep="\n")
    for line in reasons(verdict, all_of_them=showing.verbose):
        out.print(line, soft_wrap=True)
    for key, value in files.items():
        if isinstance(value, Path):
            print(f"{key}: {value}")
    if "bag" in files:
        print(f"report: {shlex.join((console.program(), 'report', str(files['bag'])))}")
    return verdict.exit_code
