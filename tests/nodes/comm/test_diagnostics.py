"""What a node logs of its status."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, StatusLog

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
