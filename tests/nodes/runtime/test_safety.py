"""The safety state of a process: the worst of what concerns it."""

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel
from ptnsbc_nodes.runtime.safety import Concern, SafetyState, assess

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
