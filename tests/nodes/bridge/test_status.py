"""The status of a bridge about its vehicle."""

from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("rclpy")

from ptnsbc_nodes.bridge.procedure.steps import BEFORE_ARMING, FLYING, Step, Stream
from ptnsbc_nodes.bridge.status import procedure_concern, vehicle_record
from ptnsbc_nodes.comm.diagnostics import SafetyState, assess
from ptnsbc_nodes.emergency import VehicleRecord

BASE = VehicleRecord("bridge1", 1, 1, "px4", "udpin:127.0.0.1:14540")


def bridge(step, *, armed, flew, silence_s):
    """As much of a bridge as its record needs."""
    return SimpleNamespace(
        procedure=SimpleNamespace(
            step=step,
            over=step in (Step.DONE, Step.FAILED),
            fault="",
            in_pilots_hands=False,
            stands=False,
        ),
        vehicle=SimpleNamespace(
            heartbeat_age_s=lambda _now: silence_s, armed=armed, landed=True, mode_name="OFFBOARD"
        ),
        link=SimpleNamespace(peer=("127.0.0.1", 14580)),
        ports=SimpleNamespace(
            steady_s=lambda: 100.0,
            inputs=SimpleNamespace(order=SimpleNamespace(text="kill")),
        ),
        placement=SimpleNamespace(text=""),
        state_publisher=SimpleNamespace(world=SimpleNamespace(frame="")),
        fate="",
        flew=flew,
    )


@pytest.mark.parametrize(
    ("step", "armed", "flew", "silence_s", "heard"),
    [
        (Step.FLY, True, True, 0.5, True),
        (Step.FLY, True, True, 5.0, False),
        (Step.KILL, False, True, 5.0, False),  # not confirmed yet
        (Step.FAILED, False, True, 5.0, True),  # disarmed was its last word
        (Step.FAILED, True, True, 40.0, False),  # given up while it was silent
        (Step.FAILED, False, False, 40.0, True),  # it stands where its bridge gave up
    ],
)
def test_after_the_flight_the_last_word_of_the_vehicle_stands(step, armed, flew, silence_s, heard):
    """A starved bridge answered a kill three seconds after it had stopped the motors: "never heard"."""
    found = vehicle_record(bridge(step, armed=armed, flew=flew, silence_s=silence_s), BASE)
    assert found.heard is heard


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
