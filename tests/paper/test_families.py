"""The figures of the shipped families, and the table of the page that is made of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs.make import shares
from paper import families
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.family import families as shipped
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_sim.sweep.rows import MARGINS, fly_draw
from ptnsbc_sim.sweep.search import NO_MARGIN, Found
from ptnsbc_tools.sweeps.summary import FlownSweep, table_of

PLAN = plan_of(load_scenario("paper_5_free", {"timing.duration_s": 6.0}), 2)


@pytest.fixture
def data(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    for module in (families, shares):
        monkeypatch.setattr(module, "DATA", tmp_path)
    return tmp_path


def test_every_shipped_family_has_its_row() -> None:
    assert sorted(shares.FAMILIES) == sorted(shipped())


def test_refused_flights_are_counted_and_have_no_worst_margin() -> None:
    refused = [NO_MARGIN] * len(MARGINS)
    margins = np.array([refused, [0.5, -0.1, NO_MARGIN], [0.2, 0.4, NO_MARGIN]])
    found = families.searched(Found(PLAN, margins, None))
    assert found == {
        "flights": 3,
        "refused": 1,
        "broken": {"keep_out_margin": 0, "deadline_margin": 1, "return_margin": 0},
        "worst": {"keep_out_margin": 0.2, "deadline_margin": -0.1, "return_margin": None},
    }


def test_met_and_in_place_count_the_accepted() -> None:
    flown = fly_draw(PLAN, 0)[0]
    rows = [replace(row, check="accepted") for row in flown]
    rows += [replace(row, draw=1, check="refused", in_place=False) for row in flown]
    found = families.swept(FlownSweep(replace(PLAN, check=1), Path(), table_of(rows)))
    counts = [(found[name]["count"], found[name]["of"]) for name in ("accepted", "met", "in_place")]
    assert counts == [(1, 2), (1, 1), (1, 1)]
    assert found["closest_uav_m"] == pytest.approx(min(row.closest_uav_m for row in flown))


def test_without_dry_runs_nothing_is_accepted_or_refused() -> None:
    rows = fly_draw(PLAN, 0)[0]
    found = families.swept(FlownSweep(PLAN, Path(), table_of(rows)))
    assert found["accepted"] is None
    assert (found["met"]["count"], found["met"]["of"]) == (1, 1)


def test_a_part_that_is_flown_again_leaves_the_others(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {
        "flights": 9,
        "refused": 2,
        "broken": dict.fromkeys(MARGINS, 0) | {MARGINS[1]: 3},
        "worst": dict.fromkeys(MARGINS, 0.0123) | {MARGINS[2]: None},
    }
    rare = {"probability": 0.0, "low": 0.0, "high": 1e-4, "flights": 5000}
    figures: dict[str, dict[str, Any]] = {"search": found, "rare": rare}
    monkeypatch.setattr(families, "fly", lambda family, part, given: figures[part])
    for part in figures:
        assert families.main(["near", "--part", part]) == 0
    row = next(line for line in shares.regions()["families"].splitlines() if "`near`" in line)
    assert row == (
        "| `near` |"
        + 4 * " not flown |"
        + " 9 | 2 | 1.2 % | 1.2 %, broken by 3 | none made | at most 0.0001 |"
    )


def test_a_family_that_is_unknown_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert families.main(["nobody"]) == 2
    assert "nobody: no such family" in capsys.readouterr().err
