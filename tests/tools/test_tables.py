"""What a flight prints: a sentence, a row for each UAV, the least distances; on one screen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flights import away, counters, flight

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import Verdict, verdict_on
from ptnsbc_tools.options import Showing
from ptnsbc_tools.tables import (
    show_verdict,
    verdict_sentence,
    verdict_summary,
    verdict_tables,
)


@pytest.fixture(scope="module")
def late() -> Verdict:
    """UAV 4 gives way to a tree over the deadline, and UAV 3 after it."""
    beside = flight({4: away(4.0, 6.0)}).odometry[4].values[500, :3] + [0.0, 0.0, 0.6]
    tree = {"name": "tree", "position_m": beside.tolist(), "keep_out_m": 0.3}
    scenario = load_scenario("paper_5_free", {"timing.duration_s": 12, "world.obstacles": [tree]})
    busy = {
        4: counters(12.0, lambda t: np.clip(t - 4.5, 0.0, 1.05)),
        3: counters(12.0, lambda t: np.clip(t - 8.0, 0.0, 0.6)),
    }
    errors = {4: away(4.0, 6.0), 3: away(8.2, 8.8)}
    return verdict_on(flight(errors, counters=busy, scenario=scenario))


def test_the_sentence_says_who_was_there_and_why_others_came_later(late: Verdict) -> None:
    text = verdict_sentence(late).plain
    assert text.startswith(
        "Verdict: met late. 4 of 5 in place by 5 s, 1 later because it gave way to tree, the last at 6.0 s. "
    )
    assert "Nearest: UAV 3 and UAV 4, 0.70 m (0.50 to be kept)." in text
    assert text.endswith(
        "1 UAV gave way later, or followed one that did: 0.50 m off, "
        "back 0.0 s after the encounter, at most."
    )


@pytest.mark.parametrize(("strict", "state"), [(False, "met late (tree)"), (True, "missed (tree)")])
def test_a_flight_of_five_fits_on_a_screen(
    late: Verdict, capsys: pytest.CaptureFixture[str], strict: bool, state: str
) -> None:
    code = show_verdict(late, Showing(strict=strict))
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert code == int(strict)
    assert len(lines) <= 24
    assert strict or max(map(len, lines)) <= 80  # a reason is one line, for grep
    assert any(line.endswith(state) for line in lines)
    assert any(line.startswith("UAV 4 and tree ") for line in lines)


def test_all_figures_are_there_on_request(
    late: Verdict, capsys: pytest.CaptureFixture[str]
) -> None:
    show_verdict(late, Showing(verbose=True))
    out = capsys.readouterr().out
    for title in ("settled s", "Way back after encounters", "Input", "Separation"):
        assert title in out


def test_a_leg_that_was_not_flown_has_no_rows(late: Verdict) -> None:
    assert len(verdict_summary(late).rows) == 5
    assert verdict_summary(late, ()).rows == ()
    assert verdict_summary(late, ()).table().row_count == 0
    unflown = replace(late.legs[0], uavs=(), reason="the leg was not flown")
    shown = [table.row_count for table in verdict_tables(replace(late, uavs=(), legs=(unflown,)))]
    assert shown[0] == 0
