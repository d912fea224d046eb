"""What a flight may end with after a signal to one of its processes."""

import pytest

pytest.importorskip("rclpy")

from bench.signals import _exit_codes


def test_only_a_pause_leaves_no_trace():
    assert _exit_codes("uav1", "pause") == _exit_codes("sim", "pause") == {0}
    for victim in ("uav1", "sim", "recorder", "launcher"):
        assert 0 not in _exit_codes(victim, "kill") | _exit_codes(victim, "stop")
