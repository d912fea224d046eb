"""Ratios and targets of a row, by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # the benchmark is in no wheel

from bench.table import Row, Target, number


def test_ratios_are_taken_run_by_run():
    # The third run of both fell into a busy moment: the ratio does not see it.
    row = Row("steps", [6.0, 8.0, 3.0], "steps/s", "bare", [10.0, 10.0, 5.0])
    assert row.value == 6.0
    assert row.ratio == pytest.approx(0.6)


def test_no_ratio_between_different_units_or_with_nothing():
    assert Row("a", [1.0], "s", "b", [1.0], "ms").ratio is None
    assert Row("a", [1.0], "s", "b", [0.0]).ratio is None
    assert Row("a", [1.0], "s").ratio is None


@pytest.mark.parametrize(
    ("target", "met", "text"),
    [
        (Target(6.0), True, "≤ 6.00 steps/s"),
        (Target(5.9), False, "≤ 5.90 steps/s"),
        (Target(7.0, at_least=True), False, "≥ 7.00 steps/s"),
        (Target(0.6, at_least=True, of_reference=True), True, "≥ 60 % of ref."),
        (Target(0.7, at_least=True, of_reference=True), False, "≥ 70 % of ref."),
    ],
)
def test_targets(target, met, text):
    row = Row("steps", [6.0], "steps/s", "bare", [10.0], target=target)
    assert row.met is met
    assert row.as_json()["target"] == text


def test_numbers_have_three_digits():
    assert [number(x) for x in (20_000.0, 27.34, 7.789, 0.04567)] == [
        "20,000",
        "27.3",
        "7.79",
        "0.046",
    ]
