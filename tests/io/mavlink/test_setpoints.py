"""Setpoint messages: type masks that real autopilots were seen to accept, and the body rates that each is sent."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4
from ptnsbc_io.mavlink.setpoints import AttitudeTarget, SetpointMessages


@pytest.mark.parametrize(
    ("vectors", "mask"),
    [
        ({"velocity"}, 0x09C7),
        ({"position", "velocity"}, 0x09C0),
        ({"velocity", "acceleration"}, 0x0807),  # bit 0x200 would make a force of it
        ({"position"}, 0x09F8),
    ],
)
def test_position_target_masks(vectors, mask):
    given = dict.fromkeys(vectors, np.array([1.0, 2.0, 3.0]))
    message = SetpointMessages(PX4, 3).position_target(1.0, 0.0, **given)
    assert message.type_mask == mask
    assert [message.vx, message.vy, message.vz] == (
        [2, 1, -3] if "velocity" in vectors else [0] * 3
    )


def on_the_wire(autopilot, attitude, rates):
    target = AttitudeTarget(attitude, np.array(rates, dtype=float), 0.5)
    return SetpointMessages(autopilot, 3).attitude_target(1.0, target)


def body_rates(message):
    return [message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate]


ROLLED = quaternion_from_euler(np.array([0.1, 0.0, 0.0]))  # right side down
# Left about the vertical by 1 rad/s: in the rolled body (0, sin 0.1, cos 0.1) FLU, and FRD turns y and z round.
LEFT = (0.0, math.sin(0.1), math.cos(0.1))


def test_px4_is_sent_the_heading_rate_about_the_vertical():
    message = on_the_wire(PX4, ROLLED, LEFT)
    assert message.type_mask == 0b00000011  # roll and pitch rates ignored
    assert body_rates(message) == pytest.approx([0, 0, -1.0])
    # A rolling target turns no heading.
    assert body_rates(on_the_wire(PX4, ROLLED, (0.7, 0, 0))) == pytest.approx([0, 0, 0])


def test_arducopter_is_sent_all_three_of_a_turn_about_the_vertical():
    message = on_the_wire(ARDUPILOT, ROLLED, LEFT)
    assert message.type_mask == 0  # it drops a target with some of them
    assert body_rates(message) == pytest.approx([0, -math.sin(0.1), -math.cos(0.1)])
    assert body_rates(on_the_wire(ARDUPILOT, ROLLED, (0.7, 0, 0))) == pytest.approx([0, 0, 0])


def test_a_controller_of_attitudes_is_sent_everything():
    message = on_the_wire(GENERIC, ROLLED, (0.7, 0.2, 0.3))
    assert message.type_mask == 0
    assert body_rates(message) == pytest.approx([0.7, -0.2, -0.3])
