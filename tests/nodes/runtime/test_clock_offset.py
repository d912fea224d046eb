"""Whose clock is not ours: told by the least age of messages, not by late ones."""

import numpy as np
import pytest

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.runtime.clock_offset import LIMIT_S, ClockOffsetMonitor

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
    offset = heard([ahead_s] * 450)
    assert offset.ahead_s == pytest.approx(ahead_s)
    assert str(offset) == told


def test_a_clock_within_the_limit_is_ours():
    assert heard([0.9 * LIMIT_S] * 450) is None
    assert heard([-0.9 * LIMIT_S] * 450) is None


def test_late_messages_are_no_offset():
    assert heard(([0.4] * 39 + [0.01]) * 5) is None


def test_nothing_is_said_before_a_window_is_over():
    assert heard([0.3] * 50) is None


def test_a_message_that_is_held_does_not_age_into_an_offset():
    watch = ClockOffsetMonitor(["/uav1/odom"])
    assert heard([0.01] * 250, watch=watch) is None
    last = Stamped(10**18 + 249 * STEP_NS, NOTHING)
    for k in range(250, 1000):
        watch.look(10**18 + k * STEP_NS, [last])
    assert watch.offset is None


def test_a_clock_that_is_set_right_is_forgiven():
    watch = ClockOffsetMonitor(["/uav1/odom"])
    assert heard([0.3] * 450, watch=watch) is not None
    assert heard([0.01] * 450, watch=watch, since_ns=10**18 + 450 * STEP_NS) is None


def test_the_worst_of_several_is_named_and_who_is_silent_is_left_out():
    watch = ClockOffsetMonitor(["uav1", "uav2", "uav3"])
    for k in range(450):
        now_ns = 10**18 + k * STEP_NS
        newest = [Stamped(now_ns, NOTHING), Stamped(now_ns + 200_000_000, NOTHING), None]
        watch.look(now_ns, newest)
    assert watch.offset.name == "uav2"
