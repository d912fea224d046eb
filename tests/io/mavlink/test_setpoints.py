"""Setpoint messages: type masks that real autopilots were seen to accept, and the body rates that each is sent."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_io.mavlink import setpoints
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4
from ptnsbc_io.mavlink.setpoints import AttitudeTarget, SetpointMessages


@pytest.mark.parametrize(
    ("used", "mask"),
    [
        ((*setpoints.VELOCITY, "yaw_rate"), 0x05C7),  # both were tried on PX4
        (("vx", "vy", "z", "yaw_rate"), 0x05E3),
        ((*setpoints.VELOCITY, "yaw"), 0x09C7),
        ((*setpoints.POSITION, *setpoints.VELOCITY, "yaw"), 0x09C0),
        ((*setpoints.VELOCITY, *setpoints.ACCELERATION, "yaw"), 0x0807),
        ((*setpoints.POSITION, "yaw"), 0x09F8),
    ],
)
def test_position_target_masks(used, mask):
    assert setpoints.position_target_mask(used) == mask


def test_attitude_target_masks():
    assert setpoints.attitude_target_mask(("q", "thrust")) == 0b00000111
    assert setpoints.attitude_target_mask(("q", "thrust", *setpoints.RATES)) == 0
    assert setpoints.attitude_target_mask((*setpoints.RATES, "thrust")) == 0b10000000


def test_a_setpoint_never_means_force():
    assert setpoints.position_target_mask(setpoints.ACCELERATION) & 0x200 == 0


@pytest.mark.parametrize("used", [(), ("vx", "speed")])
def test_nothing_and_unknown_fields_are_refused(used):
    with pytest.raises(setpoints.MaskError, match="expected some of x, y, z"):
        setpoints.position_target_mask(used)


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
