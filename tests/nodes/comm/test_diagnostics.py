"""What a node logs of its status."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

import pytest

from ptnsbc_nodes.comm.diagnostics import Concern, DiagnosticLevel, SafetyState, StatusLog, assess

OK, WARN, ERROR = DiagnosticLevel.OK, DiagnosticLevel.WARN, DiagnosticLevel.ERROR


@pytest.fixture
def logged():
    """A log with a clock that the test sets, and what it has written."""
    lines, clock = [], SimpleNamespace(now_s=0.0)
    kinds = {
        name: lambda text, name=name: lines.append((name, text))
        for name in ("info", "warning", "error")
    }
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(**kinds))
    return StatusLog(node, lambda: clock.now_s), clock, lines


def test_a_change_of_the_level_and_no_repetition(logged):
    log, clock, lines = logged
    for now_s, level, message in [
        (0.0, OK, ""),
        (2.0, WARN, "waiting for /uav2/odom"),
        (4.0, WARN, "waiting for /uav3/odom"),
        (6.0, ERROR, "own odometry is stale"),
        (8.0, OK, ""),
        (9.5, OK, ""),
    ]:
        clock.now_s = now_s
        log.note(level, message)
    assert lines == [
        ("warning", "waiting for /uav2/odom"),
        ("error", "own odometry is stale"),
        ("info", "all is well"),
    ]


def test_a_status_that_flutters_is_logged_once_a_second(logged):
    log, clock, lines = logged
    for k in range(50):  # 5 Hz
        clock.now_s = 0.2 * k
        log.note(WARN if k % 2 else OK, "holding")
    assert 5 <= len(lines) <= 11


OK, WARN, ERROR = DiagnosticLevel


def test_without_a_concern_all_is_nominal():
    assert assess([]) == (SafetyState.NOMINAL, OK, "")


def test_the_worst_decides_and_no_reason_is_lost():
    found = assess(
        [
            Concern(SafetyState.DEGRADED, ERROR, "a clock is off"),
            Concern(SafetyState.HOLD_CLEAR, WARN, "holding"),
            Concern(SafetyState.DEGRADED, WARN, "2 ticks missed"),
        ]
    )
    assert found == (SafetyState.HOLD_CLEAR, ERROR, "holding; a clock is off; 2 ticks missed")


def test_the_states_have_one_name_each_from_all_to_nothing():
    assert [one.text for one in sorted(SafetyState)] == [
        "nominal",
        "degraded",
        "hold clear",
        "land",
        "stop",
    ]
