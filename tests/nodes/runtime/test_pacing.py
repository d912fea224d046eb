"""Missed ticks, latencies, and the phase of the tick."""

import time

import pytest

from ptnsbc_nodes.runtime.pacing import Latency, Pace, Ticker, delay_ns

PERIOD = 10


def paced(*times):
    pace = Pace(PERIOD)
    return [pace.tick(t) for t in times], pace.missed


def test_ticks_on_time():
    assert paced(0, 10, 20, 30) == ([1, 1, 1, 1], 0)


def test_jitter_below_a_period_misses_nothing():
    assert paced(0, 19, 20, 35, 40) == ([1, 1, 1, 1, 1], 0)


def test_a_gap_counts_the_ticks_in_it():
    assert paced(0, 10, 45, 50) == ([1, 1, 3, 1], 2)


def test_the_grid_starts_at_the_earliest_tick():
    # The first was 8 late: a later one that is 11 late has missed one.
    assert paced(8, 10, 31) == ([1, 1, 2], 1)


def test_latency_percentiles():
    latency = Latency()
    assert latency.percentile_s(50) == 0.0
    for ms in range(1, 101):
        latency.add(ms * 1e-3)
    assert latency.percentile_s(50) == pytest.approx(0.0505)
    assert latency.max_s == 0.1


def test_percentiles_are_of_the_newest_latencies_and_the_largest_of_all():
    latency = Latency()
    for ms in range(1, 12_001):
        latency.add(ms * 1e-3)
    assert latency.percentile_s(0) == 7.001
    assert latency.percentile_s(100) == latency.max_s == 12.0


@pytest.mark.parametrize(
    ("now", "wait"), [(1000, 300), (1299, 1), (1300, 0), (1301, 999), (51_000, 300), (500, 800)]
)
def test_ticks_fall_a_third_of_a_period_behind_the_stamps(now, wait):
    assert delay_ns(now, stamp_ns=1000, period_ns=1000) == wait


@pytest.mark.ros
@pytest.mark.parametrize("apart_s", [0.0, 0.004])
def test_alignments_in_a_row_do_not_stop_the_ticks(ros, apart_s):
    """Two legs announced at once; the latched legs of a flight that a late UAV receives; a leg that is repeated."""
    ticks = []
    ticker = Ticker(ros.node("ticker"), 20_000_000, lambda: ticks.append(1))
    ros.spin_until(lambda: ticks)
    for _ in range(200 if apart_s else 5):
        ticker.align(time.time_ns())
        ros.spin_for(apart_s)
    count = len(ticks)
    if apart_s:
        assert count > 10  # the alignments themselves lasted 40 periods
    ros.spin_until(lambda: len(ticks) > count + 10, timeout=30.0)
    ticker.close()
