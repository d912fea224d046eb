"""The table of defaults in docs/scenarios.md says what the code does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from ptnsbc_sim.scenario.defaults import gain_defaults

_PAGE = Path(__file__).resolve().parents[3] / "docs" / "scenarios.md"
_PLANTS = ("quadrotor", "rigid_body_6dof")


def _rows(pattern: str) -> list[tuple[str, ...]]:
    gains = _PAGE.read_text(encoding="utf-8").partition("## `gains`")[2]
    return [match.groups() for match in re.finditer(pattern, gains, re.MULTILINE)]


def _documented(cell: str, plant: str) -> str:
    first, _, second = cell.partition(" / ")
    return second if second and plant == _PLANTS[1] else first


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}"


@pytest.mark.parametrize("plant", _PLANTS)
def test_single_keys_are_documented_as_they_are(plant: str) -> None:
    defaults = gain_defaults(plant)
    rows = _rows(r"^\| `([a-z]+)\.([a-z0-9_]+)` \| [^|]*\| ([^|]+?) \|")
    assert len(rows) > 30
    for block, key, cell in rows:
        assert _documented(cell, plant) == _shown(defaults[block][key]), f"{block}.{key}"


@pytest.mark.parametrize("plant", _PLANTS)
def test_loops_are_documented_as_they_are(plant: str) -> None:
    defaults = gain_defaults(plant)
    rows = _rows(r"^\| `([a-z]+)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \| ([^|]+) \|[^|]*\|$")
    assert {row[0] for row in rows} == {"formation", "attitude", "force", "torque", "clearance"}
    for block, *cells in rows:
        keys = ("deadline_s", "residual", "scale", "kappa_1_s")
        for key, cell in zip(keys, cells, strict=True):
            if cell != "**required**":
                assert _documented(cell, plant) == _shown(defaults[block][key]), f"{block}.{key}"
