"""What a flight may end with after a signal to one of its processes."""

import io
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from bench.signals import _exit_codes, _until_started


def test_only_a_pause_leaves_no_trace():
    assert _exit_codes("uav1", "pause") == _exit_codes("sim", "pause") == {0}
    for victim in ("uav1", "sim", "recorder", "launcher"):
        assert 0 not in _exit_codes(victim, "kill") | _exit_codes(victim, "stop")


@pytest.mark.parametrize(
    ("said", "words"),
    [("fleet started\nmore\n", ""), ("a\nerror: no\n", "the fleet did not start: error: no")],
)
def test_a_fleet_that_does_not_start_ends_no_series(said, words):
    launcher = SimpleNamespace(stderr=io.StringIO(said))
    assert _until_started(launcher) == words
