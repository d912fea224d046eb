"""Shares with their Wilson intervals."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_tools.sweeps.share import share, share_of


def test_an_interval_by_hand() -> None:
    found = share(13, 20)
    z, n, p = 1.959963984540054, 20, 0.65
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert (found.low, found.high) == pytest.approx((centre - half, centre + half))
    assert found.wide
    assert str(found) == "13 of 20, 65.0 % (43.3 to 81.9 %, wide)"


def test_none_and_all_have_one_bound() -> None:
    assert str(share(0, 1000)) == "0 of 1000, 0.0 % (at most 0.383 %)"
    assert str(share(1000, 1000)) == "1000 of 1000, 100.0 % (at least 99.617 %)"
    assert share(0, 40).interval == "at most 8.8 %"
    assert share(0, 0).as_json()["share"] is None
    assert str(share(0, 0)) == "0 of 0"


def test_wide_is_more_than_a_fifth() -> None:
    assert share(50, 60).high - share(50, 60).low < 0.2
    assert not share(50, 60).wide
    assert share(5, 10).wide


def test_the_share_of_true() -> None:
    found = share_of(np.array([True, False, True]))
    assert (found.count, found.of) == (2, 3)
