"""Body rates beside an attitude: the target's own turning, and how each autopilot is told of it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4
from ptnsbc_nodes.bridge.setpoint.attitude import AttitudeTarget
from ptnsbc_nodes.bridge.setpoint.body_rates import BodyRateEstimator, about_vertical
from ptnsbc_nodes.bridge.setpoint.messages import Setpoints

ALL = np.ones(3, dtype=bool)
DT = 0.02
SETTLED = 100  # targets: two seconds


def quaternion(roll=0.0, pitch=0.0, yaw=0.0):
    return quaternion_from_euler(np.array([roll, pitch, yaw]))


def after(targets, known=ALL):
    """Rates with the last of some targets, one every DT."""
    turning = BodyRateEstimator()
    for n, target in enumerate(targets):
        rates = turning.of(target, known, DT * n)
    return rates


def test_a_heading_that_turns_left():
    rates = after([quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0, 0, 0.5], abs=1e-4)


def test_rates_are_those_of_the_targets_body():
    # Nose up by 30 degrees, the heading turns left by 1 rad/s: in the body that is half a radian of roll.
    # FLU: nose up is a negative pitch, and z of the world is (-sin pitch, 0, cos pitch) = (0.5, 0, 0.866).
    rates = after([quaternion(0.0, -math.pi / 6, DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0.5, 0.0, math.sqrt(0.75)], abs=1e-3)


def test_a_new_target_is_no_motion_of_the_old_one():
    turned = quaternion(yaw=1.0)
    assert after([quaternion()] * 50 + [turned] * 50).tolist() == [0, 0, 0]


def test_a_target_that_is_sent_again_does_not_stop():
    turning = BodyRateEstimator()
    for n in range(SETTLED):
        for _ in range(2):  # the stream is quicker than the controller
            rates = turning.of(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert rates[2] == pytest.approx(0.5, abs=1e-4)


def test_about_an_axis_that_is_not_understood_there_is_no_rate():
    targets = [quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)]
    known = np.array([True, True, False])
    assert after(targets, known).tolist() == [0, 0, 0]


def test_after_a_gap_it_begins_anew():
    turning = BodyRateEstimator()
    for n in range(SETTLED):
        turning.of(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert turning.of(quaternion(yaw=1.1), ALL, DT * SETTLED + 1.0).tolist() == [0, 0, 0]


def test_a_vehicle_that_lags_is_not_chased_round():
    """The heading of a target that is at most 0.15 rad ahead, as after a torque at its limit.

    A vehicle that adds the rates to its own would turn for ever if they were the vehicle's.
    """
    turning, yaw, goal, fastest = BodyRateEstimator(), 0.0, 1.5, 0.0
    for n in range(500):
        ahead = min(goal - yaw, 0.15)
        known = np.array([True, True, goal - yaw < 0.15])
        rates = turning.of(quaternion(yaw=yaw + ahead), known, DT * n)
        rate = 4.0 * ahead + rates[2]
        fastest = max(fastest, rate)
        yaw += DT * rate
    assert yaw == pytest.approx(goal, abs=0.01)
    assert fastest <= 4.0 * 0.15 + 1e-9


def on_the_wire(autopilot, attitude, rates):
    target = AttitudeTarget(attitude, np.array(rates, dtype=float), 0.5)
    return Setpoints(autopilot, 3).attitude(1.0, target)


def told(message):
    return [message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate]


ROLLED = quaternion(roll=0.1)  # right side down
# Left about the vertical by 1 rad/s: in the rolled body (0, sin 0.1, cos 0.1) FLU, and FRD turns y and z round.
LEFT = (0.0, math.sin(0.1), math.cos(0.1))


def test_px4_is_told_the_heading_rate_about_the_vertical():
    message = on_the_wire(PX4, ROLLED, LEFT)
    assert message.type_mask == 0b00000011  # roll and pitch rates ignored
    assert told(message) == pytest.approx([0, 0, -1.0])
    # A rolling target turns no heading.
    assert told(on_the_wire(PX4, ROLLED, (0.7, 0, 0))) == pytest.approx([0, 0, 0])


def test_arducopter_is_told_all_three_of_a_turn_about_the_vertical():
    message = on_the_wire(ARDUPILOT, ROLLED, LEFT)
    assert message.type_mask == 0  # it drops a target with some of them
    assert told(message) == pytest.approx([0, -math.sin(0.1), -math.cos(0.1)])
    assert told(on_the_wire(ARDUPILOT, ROLLED, (0.7, 0, 0))) == pytest.approx([0, 0, 0])


def test_a_controller_of_attitudes_is_told_everything():
    message = on_the_wire(GENERIC, ROLLED, (0.7, 0.2, 0.3))
    assert message.type_mask == 0
    assert told(message) == pytest.approx([0.7, -0.2, -0.3])


angles = st.floats(-0.6, 0.6)


@given(angles, angles, st.floats(-3, 3), st.floats(-2, 2))
def test_the_part_about_the_vertical_is_that_of_the_heading(roll, pitch, yaw, turn):
    attitude = quaternion(roll, pitch, yaw)
    rates = turn * rotation_from_quaternion(attitude)[2]
    assert about_vertical(rates, attitude) == pytest.approx(turn, abs=1e-9)
