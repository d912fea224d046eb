"""The page: verdict and tables as plain HTML; its script draws the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

from rich.table import Table
from rich.text import Text

from ptnsbc_sim.verdict import Verdict
from ptnsbc_sim.verdict.verdict import LegVerdict
from ptnsbc_tools.plotting.flight import FlightView
from ptnsbc_tools.report.content import compressed, content
from ptnsbc_tools.tables import deadline_table, reasons, verdict_line, verdict_tables

_SCRIPTS = ("data.js", "clock.js", "camera.js", "scene.js", "charts.js", "main.js", "start.js")
_NO_VERDICT = "none"
_WORDS = ("met", "missed", "violated", "void", "error", "warning")


def asset(name: str) -> str:
    """The text of a file in assets/."""
    return files(__package__).joinpath("assets", name).read_text("utf-8")


@cache
def plotly() -> str:
    """The library plotly.js, compressed: it is larger than all the rest of the page."""
    library = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    return compressed(library)


def _item(name: str, value: str) -> str:
    return f"<li>{escape(name)} <b>{escape(value)}</b></li>"


def _facts(flight: FlightView, about: Mapping[str, str]) -> str:
    scenario = flight.scenario
    facts = {
        "UAVs": str(len(scenario.uav_ids)),
        "plant": scenario.plant.kind,
        "task": scenario.task_name,
        "profile": scenario.gains.profile,
        "avoidance": scenario.formation.avoidance,
    }
    if flight.verdict is not None:
        facts["judged"] = f"{flight.verdict.duration_s:.1f} s"
    if "mode" in about:
        facts["flown"] = about["mode"]
    return "".join(_item(name, str(value)) for name, value in facts.items())


def _cell(value: Any) -> str:
    plain = value.plain if isinstance(value, Text) else str(value)
    if plain in _WORDS:
        return f'<span class="word {plain}">{escape(plain)}</span>'
    return escape(plain)


def _name(header: Any) -> str:
    return escape(header.plain if isinstance(header, Text) else str(header))


def html_table(table: Table, title: str = "") -> str:
    """A Rich table as an HTML table in a box that scrolls by itself; `title` replaces its own."""
    sides = ["number" if column.justify == "right" else "text" for column in table.columns]
    head = "".join(
        f'<th scope="col" class="{side}">{_name(column.header)}</th>'
        for side, column in zip(sides, table.columns, strict=True)
    )
    rows = []
    for row, *cells in zip(table.rows, *(column.cells for column in table.columns), strict=True):
        look = ' class="bad"' if row.style else ""
        inside = "".join(
            f'<td class="{side}">{_cell(cell)}</td>'
            for side, cell in zip(sides, cells, strict=True)
        )
        rows.append(f"<tr{look}>{inside}</tr>")
    title = _name(title or table.title or "")
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}"><table>'
        f"<caption>{title}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _leg_table(verdict: Verdict, leg: LegVerdict) -> str:
    title = "Deadline, UAV by UAV"
    if len(verdict.legs) > 1:
        title = f"Leg {leg.number}, from {leg.epoch_s - verdict.epoch_s:.2f} s: {leg.verdict}"
    return html_table(deadline_table(replace(verdict, uavs=leg.uavs)), title)


def _details(summary: str, text: str) -> str:
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def page(flight: FlightView, about: Mapping[str, str], other: FlightView | None = None) -> str:
    """The whole page of a flight.

    Args:
        flight: what is shown.
        about: metadata of the bag.
        other: a flight whose curves are shown beside its own.
    """
    verdict, name = flight.verdict, flight.scenario.name
    line, why, deadlines, tables = f"No verdict: {flight.problem}", "", "", ""
    if verdict is not None:
        line = verdict_line(verdict).plain.partition("(")[2].rstrip(")")
        why = "".join(f"<li>{escape(one.plain)}</li>" for one in reasons(verdict))
        _, *others = verdict_tables(verdict)
        deadlines = "".join(_leg_table(verdict, leg) for leg in verdict.legs)
        tables = "".join(html_table(table) for table in others)
    recorded = "\n".join(f"{key}: {value}" for key, value in sorted(about.items()))
    return Template(asset("page.html")).substitute(
        {
            "title": f"{escape(name)} – flight report",
            "heading": escape(name),
            "facts": _facts(flight, about),
            "verdict": verdict.verdict if verdict is not None else _NO_VERDICT,
            "line": escape(line[:1].upper() + line[1:]),
            "reasons": f"<ul>{why}</ul>" if why else "",
            "deadlines": deadlines,
            "tables": tables,
            "details": (_details("Recorded with", recorded) if recorded else "")
            + _details("Scenario", flight.scenario.text),
            "data": content(flight, other),
            "plotly": plotly(),
            "view": asset("view.html"),
            "style": asset("style.css"),
            "script": "\n".join(asset(name) for name in _SCRIPTS),
        }
    )
