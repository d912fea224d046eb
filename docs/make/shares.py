"""The tables of `docs/shares.md`, of the figures that `python -m paper.families` and `paper.sight` have written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from docs.make.markdown import table

DATA = Path(__file__).resolve().parents[1] / "families"
SIGHT = DATA.with_name("sight.json")
FAMILIES = (
    "near", "near_20", "chain", "slots", "anywhere", "swap", "swap_12", "ring",
    "delay", "wind", "clutter", "clutter_fast", "mass",
)  # fmt: skip
"""In the order of the page."""
_HEADINGS = (
    "FAMILY", "accepted", "met", "in place", "closest pair", "searched", "refused of them",
    "keep-out", "deadline", "way back", "unasked, inside a keep-out",
)  # fmt: skip
_OPEN = "not flown"
_SPEEDS = ("keep-out", "stops below", "flown up to", "deepest there", "can evade below")


def regions() -> dict[str, str]:
    """Every made region of the page."""
    return {
        "families": table(_HEADINGS, map(_row, filter(_has_flown, FAMILIES))),
        "sight": table(_SPEEDS, map(_speeds, json.loads(SIGHT.read_text("utf-8"))["rows"])),
    }


def _speeds(row: dict[str, float]) -> list[str]:
    stops, flown, evades = (
        f"{row[f'{name}_m_s']:.2f} m/s" for name in ("stops", "flown", "evades")
    )
    return [
        f"{row['keep_out_m']:g} m",
        stops,
        flown,
        f"{1e3 * max(-row['room_m'], 0.0):.0f} mm",
        evades,
    ]


def _has_flown(family: str) -> bool:
    return (DATA / f"{family}.json").exists()


def _row(family: str) -> list[str]:
    parts = json.loads((DATA / f"{family}.json").read_text(encoding="utf-8"))
    return [f"`{family}`", *_swept(parts), *_searched(parts), _probability(parts)]


def _swept(parts: dict[str, Any]) -> list[str]:
    if "sweep" not in parts:
        return [_OPEN] * 4
    found = parts["sweep"]
    shares = (found[name] for name in ("accepted", "met", "in_place"))
    counts = ("not asked" if one is None else f"{one['count']} of {one['of']}" for one in shares)
    return [*counts, f"{found['closest_uav_m']:.2f} m"]


def _searched(parts: dict[str, Any]) -> list[str]:
    if "search" not in parts:
        return [_OPEN] * 5
    found = parts["search"]
    left = [
        "none made" if one is None else f"{100 * one:.1f} %{_broken(found['broken'][name])}"
        for name, one in found["worst"].items()
    ]
    return [str(found["flights"]), str(found["refused"]), *left]


def _broken(count: int) -> str:
    return f", broken by {count}" if count else ""


def _probability(parts: dict[str, Any]) -> str:
    if "rare" not in parts:
        return _OPEN
    found = parts["rare"]
    if found["probability"] == 0.0:
        return f"at most {found['high']:.2g}"
    return f"{found['probability']:.2g} ({found['low']:.2g} to {found['high']:.2g})"
