"""The page of `ptnsbc report`: facts and tables in HTML, and the data of its script: the flight in space, the figures.

The data are one gzip stream in base64: uint32 length of the text | JSON text, UTF-8, padded to 4 bytes | float32,
little-endian. A reference [offset, length] stands for each array in the text.
"""

from __future__ import annotations

import base64
import gzip
import json
import struct
from collections.abc import Mapping
from functools import cache
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.verdict import Track
from ptnsbc_sim.verdict.deadline import WORST_FIRST
from ptnsbc_tools.plotting.charts import (
    COLOURS,
    DARK_COLOURS,
    Chart,
    FlightView,
    charts,
    look,
    overlaid,
    thinned,
    timeline,
)
from ptnsbc_tools.tables import reasons, verdict_sentence, verdict_summary, verdict_tables

_FRAME_HZ = 25  # the script interpolates between frames
_MOST_POSES = 40_000  # frames times UAVs; 28 bytes each
_MOST_POINTS = 250_000  # of all curves of a page; 8 bytes each
_PATH_POINTS = 400
_OBSTACLE_HZ, _MOST_WAY_POINTS = 10, 4000  # of the way of an obstacle that moves

_SCRIPTS = ("data.js", "clock.js", "camera.js", "scene.js", "charts.js", "main.js", "start.js")
_NO_VERDICT = "none"
_WORDS = (*WORST_FIRST, "error", "warning")


class Pack:
    """Collects arrays and puts a reference in the place of each."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._floats = 0

    def add(self, values: Array) -> list[int]:
        """The reference to `values` (any shape, rows first), in floats."""
        raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
        reference = [self._floats, len(raw) // 4]
        self._parts.append(raw)
        self._floats += reference[1]
        return reference

    def encode(self, text: dict[str, Any]) -> str:
        """The pack of `text` and all arrays."""
        head = json.dumps(text, allow_nan=False, separators=(",", ":")).encode()
        head += b" " * (-len(head) % 4)
        return compressed(struct.pack("<I", len(head)) + head + b"".join(self._parts))


def compressed(data: bytes) -> str:
    """Gzip in base64, without the time of day."""
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii")


def content(flight: FlightView, other: FlightView | None = None) -> str:
    """The pack of a flight; the curves of `other` beside its own."""
    pack, shown = Pack(), list(charts(flight))
    if other is not None:
        shown = overlaid(shown, list(charts(other)), f"flight {other.name}")
    curves = max(sum(len(chart.curves) for chart in shown), 1)
    points = max(_MOST_POINTS // curves, 50)
    text: dict[str, Any] = {
        "colours": {"light": COLOURS, "dark": DARK_COLOURS},
        "space": _space(flight, pack) if flight.uavs and flight.samples > 1 else None,
        "charts": [_chart(chart, pack, points) for chart in shown],
    }
    return pack.encode(text)


def _poses_of(odometry: Track, stamps: np.ndarray[Any, np.dtype[np.int64]]) -> Array:
    """Position and quaternion (F, 7) of one UAV; the signs of the quaternions do not change."""
    told = odometry.t_ns
    # As it was told: the mean of q and -q is zero.
    turns = odometry.at(told[np.maximum(np.searchsorted(told, stamps, "right") - 1, 0)])[:, 3:7]
    flips = np.sum(turns[1:] * turns[:-1], axis=1) < 0
    turns[1:][np.cumsum(flips) % 2 == 1] *= -1.0
    return np.concatenate((odometry.at(stamps)[:, :3], turns), axis=1)


def _space(flight: FlightView, pack: Pack) -> dict[str, Any]:
    scenario, recording = flight.scenario, flight.recording
    first, last = flight.window_ns
    most = max(_MOST_POSES // len(flight.uavs), 2)
    count = min(int(seconds(last - first) * _FRAME_HZ) + 2, most)
    stamps = first + np.round(np.linspace(0, last - first, count)).astype(np.int64)
    t = flight.times(stamps)
    poses = [_poses_of(recording.odometry[uav], stamps) for uav in flight.uavs]
    vector = leader_trajectory(scenario)
    path_t = np.linspace(max(float(t[0]), 0.0), max(float(t[-1]), 0.0), _PATH_POINTS)
    path = np.stack([reference(vector, float(one)).position for one in path_t])
    flown_s, beside = np.maximum(seconds(stamps - recording.first_ns), 0.0), {}
    if scenario.formation.moves:  # (F, 3), beside the leader
        beside = {
            uav: pack.add(places_beside_leader(scenario, uav, flown_s))
            for uav in flight.uavs
            if uav != scenario.leader.id
        }
    return {
        "t": pack.add(t),
        "poses": pack.add(np.stack(poses, axis=1)),  # (F, N, 7)
        "path": pack.add(path),
        "marks": timeline(flight),
        "keepOutHeight": scenario.formation.keep_out_height,
        "uavs": [
            {
                **uav_of(scenario, uav),
                "places": beside.get(uav),
                "avoiding": flight.rising(uav, "avoidance_active_s"),
                "deadlocks": flight.rising(uav, "deadlock_s"),
            }
            for uav in flight.uavs
        ],
        "obstacles": obstacles_of(scenario, seconds(recording.start_ns - recording.first_ns)),
    }


def obstacles_of(scenario: Scenario, begin_s: float = 0.0) -> list[dict[str, Any]]:
    """The obstacles as the page's script draws them, at times from `begin_s` after the first epoch on."""
    count = min(int(scenario.timing.duration_s * _OBSTACLE_HZ) + 2, _MOST_WAY_POINTS)
    times = np.linspace(0.0, scenario.timing.duration_s, count)
    found = []
    for one in scenario.world.bodies:
        way = None
        if one.path is not None:
            places = np.round(one.motion(times).positions, 4).tolist()
            way = {"t": np.round(times - begin_s, 4).tolist(), "places": places}
        found.append(
            {
                "name": one.name,
                "kind": "half_space" if one.kind == "ground" else one.kind,
                "place": one.position.tolist(),
                "way": way,
                "keepOut": float(one.keep_out_m),
                "half": (0.5 * one.drawn().size).tolist(),
                "axes": one.axes.ravel().tolist(),
            }
        )
    return found


def uav_of(scenario: Scenario, uav: int) -> dict[str, Any]:
    """A UAV as the page's script draws it: what does not change in a flight."""
    leader = uav == scenario.leader.id
    return {
        "id": uav,
        "keepOut": scenario.keep_out_m(uav),
        "leader": leader,
        "parent": scenario.communication.parent(uav),
        "offset": None if leader else scenario.offset(uav).tolist(),
        **look(scenario.uav_ids.index(uav))._asdict(),
    }


def _chart(chart: Chart, pack: Pack, points: int) -> dict[str, Any]:
    curves = []
    for curve in chart.curves:
        kept = thinned(curve.t.size, [(curve.t, {0: curve.values})], points)[0]
        arrays = {"t": pack.add(kept.t), "values": pack.add(kept.values)}
        about = {"label": curve.label, "uavs": curve.uavs, "other": curve.other}
        curves.append({**about, **curve.look._asdict(), **arrays})
    return {**vars(chart), "curves": curves}


def asset(name: str) -> str:
    """The text of a file in assets/."""
    return files(__package__).joinpath("assets", name).read_text("utf-8")


@cache
def plotly() -> str:
    """The library plotly.js, gzip in base64: its bundle for curves, 4.1.1, as npm has plotly.js-basic-dist-min."""
    library = files(__package__).joinpath("assets", "plotly-basic.min.js.gz")
    return base64.b64encode(library.read_bytes()).decode("ascii")


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
    return "".join(
        f"<li>{escape(k)} <b>{escape(str(value))}</b></li>" for k, value in facts.items()
    )


def _plain(text: Any) -> str:
    return escape(text.plain if isinstance(text, Text) else str(text))


def html_table(table: Table, title: str = "") -> str:
    """A Rich table as an HTML table in a box that scrolls by itself; `title` replaces its own."""
    sides = ["number" if column.justify == "right" else "text" for column in table.columns]
    head = "".join(
        f'<th scope="col" class="{side}">{_plain(column.header)}</th>'
        for side, column in zip(sides, table.columns, strict=True)
    )
    rows = []
    for row, *cells in zip(table.rows, *(column.cells for column in table.columns), strict=True):
        look = ' class="bad"' if row.style else ""
        inside = ""
        for side, cell in zip(sides, map(_plain, cells), strict=True):
            shown = f'<span class="word {cell}">{cell}</span>' if cell in _WORDS else cell
            inside += f'<td class="{side}">{shown}</td>'
        rows.append(f"<tr{look}>{inside}</tr>")
    title = _plain(title or table.title or "")
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}"><table>'
        f"<caption>{title}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def page(flight: FlightView, about: Mapping[str, str], other: FlightView | None = None) -> str:
    """The whole page of a flight, with the metadata of its bag; the curves of `other` are shown beside its own."""
    verdict, name = flight.verdict, flight.scenario.name
    line, why, deadlines, tables = f"No verdict: {flight.problem}", "", "", ""
    if verdict is not None:
        line = verdict_sentence(verdict).plain.partition(". ")[2]
        why = "".join(f"<li>{escape(one.plain)}</li>" for one in reasons(verdict))
        _, *others = verdict_tables(verdict)
        for leg in verdict.legs:
            title = "Deadline, UAV by UAV"
            if len(verdict.legs) > 1:
                begin_s = leg.epoch_s - verdict.epoch_s
                title = f"Leg {leg.number}, from {begin_s:.2f} s: {leg.verdict}"
            deadlines += html_table(verdict_summary(verdict, leg.uavs).table(), title)
        tables = "".join(html_table(table) for table in others)
    recorded = "\n".join(f"{key}: {value}" for key, value in sorted(about.items()))
    details = {"Recorded with": recorded, "Scenario": flight.scenario.text}
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
            "details": "".join(
                f"<details><summary>{title}</summary><pre>{escape(text)}</pre></details>"
                for title, text in details.items()
                if text or title == "Scenario"
            ),
            "data": content(flight, other),
            "plotly": plotly(),
            "view": asset("view.html"),
            "style": asset("style.css"),
            "script": "\n".join(asset(name) for name in _SCRIPTS),
        }
    )
