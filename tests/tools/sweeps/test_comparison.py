"""Two sweeps side by side: paired by draw, with intervals, and what is worse."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_tools.sweeps.comparison import (
    ComparisonError,
    as_json,
    compare,
    line,
    median_difference,
    met_difference,
    same_draws,
    tables,
)
from ptnsbc_tools.sweeps.summary import table_of

BASE = load_scenario("paper_5")


def test_flights_that_differ_are_counted_in_pairs() -> None:
    a = np.array([True] * 20 + [False] * 10)
    b = np.array([True] * 12 + [False] * 17 + [True])
    found = met_difference(a, b)
    assert (found.only_a, found.only_b) == (8, 1)
    assert found.p == binomtest(1, 9).pvalue
    assert found.low < -7 / 30 < found.high
    assert found.worse


def test_no_difference_has_an_interval_all_the_same() -> None:
    found = met_difference(np.ones(100, dtype=bool), np.ones(100, dtype=bool))
    assert (found.p, found.worse) == (1.0, False)
    assert found.low == pytest.approx(-found.high)
    assert 0.0 < found.high < 0.05


def test_a_shift_of_the_median_is_found_with_its_interval() -> None:
    rng = np.random.default_rng(3)
    a = rng.normal(1.0, 0.5, 200)
    b = a + rng.normal(0.1, 0.05, 200)
    found = median_difference("x", "x", a, b, 0)
    assert found is not None
    assert found.low < 0.1 < found.high
    assert found.high - found.low < 0.04
    assert found == median_difference("x", "x", a, b, 0)
    assert median_difference("x", "x", a * np.nan, b, 0) is None


def test_errors_that_are_not_finite_in_both_do_not_differ() -> None:
    inf = np.inf
    found = median_difference("x", "x", np.array([inf, inf, 1.0]), np.array([inf, inf, inf]), 0)
    assert found is not None
    assert found.difference == 0.0


def test_fewer_flights_met_is_worse(made) -> None:
    good, bad = made.flights(*[True] * 40), made.flights(*[True] * 30, *[False] * 10)
    found = compare(good, bad, margin_m=0.001)
    assert found.worse
    assert "fewer flights" in line(found).plain
    assert not compare(bad, good, margin_m=0.001).worse
    assert not compare(good, good, margin_m=0.001).worse
    data = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert (data["flights"]["only_a"], data["worse"]) == (10, True)
    assert len(tables(found)) == 2


def test_a_larger_error_is_worse_beyond_the_margin(made) -> None:
    good, bad = (made.flights(*[True] * 20, error_m=error) for error in (0.02, 0.03))
    assert compare(good, bad, margin_m=0.001).worse
    assert not compare(good, bad, margin_m=0.02).worse


def test_only_draws_of_both_are_compared(made) -> None:
    found = compare(made.flights(*[True] * 5), made.flights(*[True] * 8), margin_m=0.0)
    assert found.draws == 5


def test_two_flights_are_compared_uav_by_uav(made) -> None:
    found = compare(made.flights(True), made.flights(False), margin_m=0.001)
    assert line(found).plain == "B is worse: 1 UAVs met the deadline in A and not in B"
    assert not compare(made.flights(False), made.flights(True), margin_m=0.001).worse


def test_a_uav_that_comes_later_by_the_plan_is_not_expected_in_place(made) -> None:
    late = replace(made.ROW, uav=2, in_place=None)
    found = compare(table_of([made.ROW, late]), table_of([made.ROW, late]), margin_m=0.0)
    assert (found.in_place.a.count, found.in_place.a.of, found.uavs.a.of) == (1, 1, 2)


def test_other_fleets_and_other_draws_are_refused(made) -> None:
    alone = table_of([made.ROW])
    with pytest.raises(ComparisonError, match="other UAVs"):
        compare(made.flights(True), alone, margin_m=0.0)
    with pytest.raises(ComparisonError, match="no draw"):
        compare(table_of([replace(made.ROW, draw=3)]), alone, margin_m=0.0)
    with pytest.raises(ComparisonError, match="differently \\(seed\\)"):
        same_draws(plan_of(BASE, 2), plan_of(BASE, 2, seed=1))
    same_draws(plan_of(BASE, 2), plan_of(BASE, 3, name="other"))
