"""The page: verdict and tables as plain HTML, the rest drawn by its script."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from html import escape
from importlib.resources import files
from string import Template

from ptnsbc_tools.plotting.flight import Shown
from ptnsbc_tools.report.content import content
from ptnsbc_tools.report.pack import compressed
from ptnsbc_tools.report.tables import html_table
from ptnsbc_tools.tables import deadline_table, reasons, verdict_line, verdict_tables
from ptnsbc_tools.verdict import Verdict
from ptnsbc_tools.verdict.verdict import LegVerdict

_SCRIPTS = ("data.js", "clock.js", "camera.js", "scene.js", "charts.js", "main.js")
NO_VERDICT = "none"


def _asset(name: str) -> str:
    return files(__package__).joinpath("assets", name).read_text("utf-8")


@cache
def _plotly() -> str:
    """The library, packed: as it is, it would fill the page."""
    library = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    return compressed(library)


def _item(name: str, value: str) -> str:
    return f"<li>{escape(name)} <b>{escape(value)}</b></li>"


def _facts(flight: Shown, about: Mapping[str, str]) -> str:
    scenario = flight.scenario
    facts = {
        "UAVs": str(len(scenario.uav_ids)),
        "plant": scenario.plant_kind,
        "task": scenario.file.formation.task,
        "profile": scenario.gains.profile,
        "avoidance": scenario.file.formation.avoidance,
    }
    if flight.verdict is not None:
        facts["judged"] = f"{flight.verdict.duration_s:.1f} s"
    if "mode" in about:
        facts["flown"] = about["mode"]
    return "".join(_item(name, str(value)) for name, value in facts.items())


def _leg_table(verdict: Verdict, leg: LegVerdict) -> str:
    title = "Deadline, UAV by UAV"
    if len(verdict.legs) > 1:
        title = f"Leg {leg.number}, from {leg.epoch_s - verdict.epoch_s:.2f} s: {leg.verdict}"
    return html_table(deadline_table(replace(verdict, uavs=leg.uavs)), title)


def _reasons(lines: list[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>" if lines else ""


def _details(summary: str, text: str) -> str:
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def _fill(parts: Mapping[str, str]) -> str:
    empty = dict.fromkeys(
        ("facts", "reasons", "deadlines", "tables", "details", "notice", "plotly"), ""
    )
    assets = {
        "style": _asset("style.css"),
        "script": "\n".join(_asset(name) for name in _SCRIPTS),
    }
    return Template(_asset("page.html")).substitute({**empty, **assets, **parts})


def page(flight: Shown, about: Mapping[str, str]) -> str:
    """The whole page of a flight.

    Args:
        flight: What is shown.
        about: Metadata of the bag.
    """
    verdict, name = flight.verdict, flight.scenario.name
    line, why, deadlines, tables = f"No verdict: {flight.problem}", [], "", ""
    if verdict is not None:
        line = verdict_line(verdict).plain.partition("(")[2].rstrip(")")
        why = [one.plain for one in reasons(verdict)]
        _, *others = verdict_tables(verdict)
        deadlines = "".join(_leg_table(verdict, leg) for leg in verdict.legs)
        tables = "".join(html_table(table) for table in others)
    recorded = "\n".join(f"{key}: {value}" for key, value in sorted(about.items()))
    return _fill(
        {
            "title": f"{escape(name)} – flight report",
            "heading": escape(name),
            "facts": _facts(flight, about),
            "verdict": verdict.verdict if verdict is not None else NO_VERDICT,
            "line": escape(line[:1].upper() + line[1:]),
            "reasons": _reasons(why),
            "deadlines": deadlines,
            "tables": tables,
            "details": (_details("Recorded with", recorded) if recorded else "")
            + _details("Scenario", flight.scenario.text),
            "data": content(flight),
            "plotly": _plotly(),
        }
    )
