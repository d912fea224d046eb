"""Who keeps a lock-step flight waiting: named once, told again and again, and nobody who goes on."""

import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_nodes.runtime.watchdog import (
    ENDED_S,
    SAID_S,
    SLOW_ENDED_S,
    LockstepWait,
    LockstepWatchdog,
)
from ptnsbc_sim.counters import STATUS_HZ

pytestmark = pytest.mark.ros


@pytest.fixture
def sent():
    return []


@pytest.fixture
def standstill(sent):
    return LockstepWatchdog(sent.append)


def looks(standstill, seconds, mark=7):
    for _ in range(round(seconds * STATUS_HZ)):
        standstill.look(mark, lambda: ["uav3", "uav5"])


def test_said_once_and_told_until_it_is_over(standstill, sent, capsys):
    looks(standstill, SAID_S)  # the first of them only takes the mark
    assert sent == []
    looks(standstill, ENDED_S)
    assert capsys.readouterr().err == "sim: no answer from uav3 uav5 for 3 s\n"
    (status,) = decode_diagnostics(sent[-1]).statuses
    assert status.name == "sim: world"
    assert status.values["waiting_for"] == "uav3, uav5"
    assert float(status.values["waited_s"]) == pytest.approx(SAID_S + ENDED_S - 1 / STATUS_HZ)
    told = len(sent)
    looks(standstill, SAID_S, mark=8)
    assert len(sent) == told


def test_a_slow_flight_is_none_that_stands_still(standstill, sent):
    for mark in range(20):
        looks(standstill, SAID_S - 0.2, mark)
    assert sent == []


def test_a_wait_lasts_as_long_as_the_sim_goes_on_reporting_it():
    wait = LockstepWait()
    for tenths in range(70):
        wait.reported(tenths / 10, ["uav3", *(["uav4"] if tenths > 30 else [])])
    waited = wait.stuck(7.0, {})
    assert waited["uav3"] == pytest.approx(7.0 + SAID_S)
    assert waited["uav4"] == pytest.approx(3.9 + SAID_S)
    assert wait.stuck(8.0, {}) == {}  # the reports have ceased
    wait.reported(8.0, ["uav3"])
    assert wait.stuck(8.0, {}) == {"uav3": SAID_S}


def test_who_gives_signs_of_life_and_never_answers_is_stuck_in_the_end():
    """A message that got lost for good: its UAV said that it waited, and the flight hung."""
    wait = LockstepWait()
    for tenths in range(10 * round(SLOW_ENDED_S)):
        now_s = tenths / 10
        wait.reported(now_s, ["uav3"])
        stuck = wait.stuck(now_s, {"uav3": now_s})
        assert bool(stuck) == (now_s + SAID_S >= SLOW_ENDED_S)
