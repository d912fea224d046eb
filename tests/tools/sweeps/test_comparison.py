"""Sweeps beside a first one: paired by draw, with intervals, and what is worse."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_tools.sweeps.comparison import (
    Compared,
    ComparisonError,
    as_json,
    compare,
    holm,
    median_difference,
    met_difference,
    same_draws,
)
from ptnsbc_tools.sweeps.summary import FlightTable, table_of

BASE = load_scenario("paper_5")


def beside(a: FlightTable, b: FlightTable, margin_m: float = 0.001) -> Compared:
    """B beside A."""
    (found,) = compare(a, {"B": b}, margin_m=margin_m).others
    return found


def test_flights_that_differ_are_counted_in_pairs() -> None:
    a = np.array([True] * 20 + [False] * 10)
    b = np.array([True] * 12 + [False] * 17 + [True])
    found = met_difference("met", "met", a, b, 0.05)
    assert (found.only_a, found.only_b) == (8, 1)
    assert found.p == binomtest(1, 9).pvalue
    assert found.low < -700 / 30 < found.high
    assert met_difference("met", "met", a, b, 0.01).low < found.low
    assert np.isnan(
        [met_difference("met", "met", a, b).p, met_difference("met", "met", a, b).low]
    ).all()


def test_no_difference_has_an_interval_all_the_same() -> None:
    found = met_difference("met", "met", np.ones(100, dtype=bool), np.ones(100, dtype=bool), 0.05)
    assert found.p == 1.0
    assert found.low == pytest.approx(-found.high)
    assert 0.0 < found.high < 5.0


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
    found = beside(good, bad)
    assert "B is worse: B meets the deadline in fewer flights" in str(found)
    assert not beside(bad, good).reasons
    assert not beside(good, good).reasons
    data = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert (data["differences"][0]["only_a"], data["worse"]) == (10, True)


def test_a_larger_error_is_worse_beyond_the_margin(made) -> None:
    good, bad = (made.flights(*[True] * 20, error_m=error) for error in (0.02, 0.03))
    assert str(beside(good, bad)).endswith(
        "largest after tf, with excused spans is larger by 0.01 m in the median"
    )
    assert not beside(good, bad, margin_m=0.02).reasons


def test_only_draws_of_both_are_compared(made) -> None:
    assert beside(made.flights(*[True] * 5), made.flights(*[True] * 8)).draws == 5


def test_two_flights_are_compared_uav_by_uav(made) -> None:
    found = beside(made.flights(True), made.flights(False))
    assert str(found) == "B is worse: 1 UAVs met the deadline in A and not in B"
    assert not beside(made.flights(False), made.flights(True)).reasons
    assert all(np.isnan([one.low, one.high, one.p]).all() for one in found.differences)


def test_a_uav_that_comes_later_by_the_plan_is_not_expected_in_place(made) -> None:
    late = replace(made.ROW, uav=2, in_place=None)
    found = beside(table_of([made.ROW, late]), table_of([made.ROW, late]))
    assert [one.pairs for one in found.differences[:3]] == [1, 2, 1]


def test_holm_multiplies_by_what_is_left() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.6]) == [1.0, 1.0]


def test_what_one_comparison_finds_several_may_not(made) -> None:
    """6 of 40 flights fewer: p is 0.031, and 0.062 of two comparisons; intervals grow wider too."""
    good, bad = made.flights(*[True] * 40), made.flights(*[True] * 34, *[False] * 6)
    assert beside(good, bad).reasons
    both = compare(good, {"bad": bad, "same": good}, margin_m=0.001)
    assert not both.worse and both.others[0].differences[0].p == pytest.approx(0.0625)
    assert both.others[0].differences[0].low < beside(good, bad).differences[0].low
    assert repr(both) == "bad is not worse at 5 %\nsame is not worse at 5 %"


def test_a_comparison_is_a_table_for_pandas_and_for_papers(made) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("jinja2")
    tables = {"off_line": made.flights(True, False), "50 %": made.flights(False, True)}
    found = compare(made.flights(True, True), tables, margin_m=0.001)
    frame = found.summary.to_pandas()
    assert frame["of B"].value_counts().to_dict() == {
        "off_line": len(frame) / 2,
        "50 %": len(frame) / 2,
    }
    assert frame.loc[0, ["A", "B", "B - A"]].tolist() == [100.0, 50.0, -50.0]
    text = found.summary.to_latex()
    assert r"off\_line" in text and r"50 \%" in text and r"flights met [\%]" in text
    assert "nan" not in text.lower()
    assert "flights met [%]" in str(found) and str(found).endswith("50 % is not worse at 5 %")


def test_other_fleets_and_other_draws_are_refused(made) -> None:
    alone = table_of([made.ROW])
    with pytest.raises(ComparisonError, match="other UAVs"):
        beside(made.flights(True), alone)
    with pytest.raises(ComparisonError, match="no draw"):
        beside(table_of([replace(made.ROW, draw=3)]), alone)
    with pytest.raises(ComparisonError, match="differently \\(seed\\)"):
        same_draws(plan_of(BASE, 2), plan_of(BASE, 2, seed=1))
    same_draws(plan_of(BASE, 2), plan_of(BASE, 3, name="other"))
