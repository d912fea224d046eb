"""What a bridge tells of its vehicle."""

from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("rclpy")

from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.status import vehicle_record
from ptnsbc_nodes.emergency.records import VehicleRecord

BASE = VehicleRecord("bridge1", 1, 1, "px4", "udpin:127.0.0.1:14540")


def bridge(step, *, armed, flew, silence_s):
    """As much of a bridge as its record needs."""
    return SimpleNamespace(
        procedure=SimpleNamespace(
            step=step, over=step in (Step.DONE, Step.FAILED), fault="", in_pilots_hands=False
        ),
        vehicle=SimpleNamespace(
            heartbeat_age_s=lambda _now: silence_s, armed=armed, landed=True, mode_name="OFFBOARD"
        ),
        link=SimpleNamespace(peer=("127.0.0.1", 14580)),
        ports=SimpleNamespace(
            clocks=SimpleNamespace(steady_s=lambda: 100.0),
            inputs=SimpleNamespace(order=SimpleNamespace(text="kill")),
        ),
        place="",
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
        (Step.FAILED, False, False, 40.0, False),  # never flown
    ],
)
def test_after_the_flight_the_last_word_of_the_vehicle_stands(step, armed, flew, silence_s, heard):
    """A starved bridge answered a kill three seconds after it had stopped the motors: "no vehicle"."""
    found = vehicle_record(
        "bridge1", bridge(step, armed=armed, flew=flew, silence_s=silence_s), BASE
    )
    assert found.heard is heard
