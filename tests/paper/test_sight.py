"""The speeds at which obstacles that come into sight late were passed, and the table of the page."""

from __future__ import annotations

import math

import pytest

from docs.make import shares
from paper import sight


def test_a_sphere_on_the_leaders_line_is_passed_with_room() -> None:
    assert 0.0 < sight.room_m(2.0, 1.0, (0.0, 0.3)) < 0.1


def test_speeds_count_until_one_is_deeper_than_the_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lower speed that grazes counts, a higher one that passes does not."""
    rooms = {1.0: 0.02, 1.25: -0.019, 1.5: 0.01, 1.75: -0.021, 2.0: 0.02}
    monkeypatch.setattr(sight, "SPEEDS_M_S", list(rooms))
    monkeypatch.setattr(sight, "least_room_m", lambda speed, keep_out: rooms[speed])
    found = sight.row(1.0)
    assert (found["flown_m_s"], found["room_m"]) == (1.5, -0.019)
    assert found["evades_m_s"] == pytest.approx(4.0 / (0.05 + 0.01 + math.sqrt(2.0 / 10.0)))
    assert 0.0 < found["stops_m_s"] < found["evades_m_s"]


def test_the_page_has_a_row_for_each_sphere() -> None:
    rows = shares.regions()["sight"].splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == [f"{d:g} m" for d in sight.KEEP_OUTS_M]
