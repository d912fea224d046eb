"""Missed ticks, latencies, and the phase of the tick."""

import time

import numpy as np
import pytest

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.runtime.pacing import LIMIT_S, ClockOffsetMonitor, Latency, Pace, Ticker, delay_ns

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


STEP_NS = 10_000_000
NOTHING = np.zeros(13)


def heard(ages_s, *, watch=None, since_ns=10**18):
    """What a watch makes of one sender whose messages have these ages, one every 10 ms."""
    watch = watch or ClockOffsetMonitor(["/uav1/odom"])
    for k, age_s in enumerate(ages_s):
        now_ns = since_ns + k * STEP_NS
        watch.look(now_ns, [Stamped(now_ns - round(age_s * 1e9), NOTHING)])
    return watch.offset


@pytest.mark.parametrize(
    ("ahead_s", "told"),
    [(0.3, "clock 0.30 s ahead of /uav1/odom"), (-0.3, "clock 0.30 s behind /uav1/odom")],
)
def test_an_offset_is_told_with_its_direction(ahead_s, told):
    assert heard([ahead_s] * 450) == told


def test_a_clock_within_the_limit_is_ours():
    assert heard([0.9 * LIMIT_S] * 450) == ""
    assert heard([-0.9 * LIMIT_S] * 450) == ""


def test_late_messages_are_no_offset():
    assert heard(([0.4] * 39 + [0.01]) * 5) == ""


def test_nothing_is_said_before_a_window_is_over():
    assert heard([0.3] * 50) == ""


def test_a_message_that_is_held_does_not_age_into_an_offset():
    watch = ClockOffsetMonitor(["/uav1/odom"])
    assert heard([0.01] * 250, watch=watch) == ""
    last = Stamped(10**18 + 249 * STEP_NS, NOTHING)
    for k in range(250, 1000):
        watch.look(10**18 + k * STEP_NS, [last])
    assert watch.offset == ""


def test_a_clock_that_is_set_right_is_forgiven():
    watch = ClockOffsetMonitor(["/uav1/odom"])
    assert heard([0.3] * 450, watch=watch) != ""
    assert heard([0.01] * 450, watch=watch, since_ns=10**18 + 450 * STEP_NS) == ""


def test_the_worst_of_several_is_named_and_who_is_silent_is_left_out():
    watch = ClockOffsetMonitor(["uav1", "uav2", "uav3"])
    for k in range(450):
        now_ns = 10**18 + k * STEP_NS
        newest = [Stamped(now_ns, NOTHING), Stamped(now_ns + 200_000_000, NOTHING), None]
        watch.look(now_ns, newest)
    assert watch.offset.endswith(" uav2")
