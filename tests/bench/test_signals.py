"""What a flight may end with after a signal to one of its processes."""

import io
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from bench.signals import BridgeSteps, _exit_codes, _steps, _until_started
from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.topics import DIAGNOSTICS

SIMULATED = BridgeSteps()  # no bridge


def test_only_a_pause_leaves_no_trace():
    assert _exit_codes("uav1", "pause", SIMULATED) == {0}
    assert _exit_codes("sim", "pause", SIMULATED) == {0}
    for victim in ("uav1", "sim", "recorder", "launcher"):
        orders = (_exit_codes(victim, order, SIMULATED) for order in ("kill", "stop"))
        assert 0 not in set().union(*orders)


@pytest.mark.parametrize(
    ("steps", "codes"),
    [
        (BridgeSteps("in formation", "no setpoints: left to the vehicle's failsafe"), {1}),
        (BridgeSteps("in formation", "landing"), {0, 1}),
        (BridgeSteps("landing", "landing"), {0}),
    ],
)
def test_a_pause_that_leaves_a_flying_vehicle_to_its_failsafe_is_told_by_the_exit_code(
    steps, codes
):
    assert _exit_codes("uav3", "pause", steps) == _exit_codes("bridge3", "pause", steps) == codes


def test_the_steps_of_a_bridge_are_those_before_and_after_its_setpoints_stopped(tmp_path):
    with BagWriter(tmp_path / "bag", [TopicInfo(DIAGNOSTICS.name, DIAGNOSTICS.type)]) as writer:
        for stamp_ns, step in ((1, "taking off"), (2, "a"), (3, "b"), (600_000_000, "c")):
            for bridge in (3, 4):
                values = {"step": step if bridge == 3 else "landing"}
                name = f"bridge{bridge}: link"
                data = diagnostics(stamp_ns, name, DiagnosticLevel.OK, "", values)
                writer.write(DIAGNOSTICS.name, stamp_ns, data)
    assert _steps(tmp_path / "bag", "uav3", 2) == _steps(tmp_path / "bag", "bridge3", 2)
    assert _steps(tmp_path / "bag", "uav3", 2) == BridgeSteps("a", "c")
    assert _steps(tmp_path / "bag", "sim", 2) == SIMULATED


@pytest.mark.parametrize(
    ("said", "words"),
    [("fleet started\nmore\n", ""), ("a\nerror: no\n", "the fleet did not start: a error: no")],
)
def test_a_fleet_that_does_not_start_ends_no_series(said, words):
    launcher = SimpleNamespace(stderr=io.StringIO(said))
    assert _until_started(launcher) == words
