"""Every step of a flight in the terms that all processes share."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from ptnsbc_nodes.bridge.procedure.safety import procedure_concern
from ptnsbc_nodes.bridge.procedure.steps import BEFORE_ARMING, FLYING, Step, Stream
from ptnsbc_nodes.comm.diagnostics import SafetyState, assess


def state(step, stream=Stream.NONE, fault=""):
    return assess(procedure_concern(step, stream, fault)).state


@pytest.mark.parametrize("step", [*BEFORE_ARMING, *FLYING, Step.ARMED, Step.DONE])
def test_a_flight_as_planned_is_nominal(step):
    assert state(step, Stream.PLANNER) is SafetyState.NOMINAL


@pytest.mark.parametrize("step", [one for one in Step if one not in (*FLYING, *BEFORE_ARMING)])
def test_every_other_step_but_the_last_and_the_wait_for_others_asks_for_a_state(step):
    expected = step not in (Step.DONE, Step.ARMED)
    assert (state(step) is not SafetyState.NOMINAL) is expected


@pytest.mark.parametrize(
    ("step", "stream", "expected"),
    [
        (Step.FLY, Stream.HOLD, SafetyState.HOLD_CLEAR),
        (Step.APART, Stream.APART, SafetyState.HOLD_CLEAR),
        (Step.FAILSAFE, Stream.NONE, SafetyState.STOP),
        (Step.LAND, Stream.HOLD, SafetyState.LAND),
        (Step.KILL, Stream.NONE, SafetyState.STOP),
    ],
)
def test_the_states_of_a_flight_that_goes_wrong(step, stream, expected):
    assert state(step, stream, "a reason") is expected


def test_what_happened_before_does_not_count_once_the_formation_goes_on():
    assert state(Step.FLY, Stream.PLANNER, "no setpoints") is SafetyState.NOMINAL
    assert state(Step.AIRBORNE, Stream.CLIMB, "no setpoints") is SafetyState.DEGRADED
