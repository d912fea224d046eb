"""What a neighbour reports, and what it means a little later."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.behaviours import neighbour as laws
from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, velocity_enu
from ptnsbc_core.types import NEVER_RECEIVED_S, NeighbourMotion

extrapolated = on_arrays(laws.extrapolated)
neighbour_motion = on_arrays(laws.neighbour_motion)
reported_velocity = on_arrays(laws.reported_velocity)

DT, STALE_S, LIMIT = 0.01, 0.5, 20.0
ATTITUDE = quaternion_from_euler(np.array([0.2, -0.1, 0.7]))


def message(position, velocity_enu_m_s):
    """A formation_state (13,) whose velocity is given in the world."""
    vector = np.zeros(13)
    vector[:3], vector[3:7] = position, ATTITUDE
    vector[7:10] = rotation_from_quaternion(ATTITUDE).T @ velocity_enu_m_s
    return vector


def moving(t):
    """Position, velocity and acceleration of a neighbour under constant acceleration."""
    acceleration = np.array([1.0, -0.5, 0.2])
    velocity = np.array([0.3, 0.2, -0.1]) + acceleration * t
    position = np.array([5.0, 1.0, 8.0]) + np.array([0.3, 0.2, -0.1]) * t + acceleration * t**2 / 2
    return position, velocity, acceleration


def received(stamps, now):
    """The motion after messages of these stamps; each carries the velocity commanded for DT after its stamp."""
    motion = laws.UNKNOWN
    for stamp in stamps:
        position, _, _ = moving(stamp)
        _, command, _ = moving(stamp + DT)
        state = message(position, command)
        motion = neighbour_motion(motion, state, 0.0, stamp, STALE_S, LIMIT)
    return state, motion, now - stamps[-1]


@pytest.mark.parametrize("age", [0.0, DT, 0.05, 0.15])
def test_constant_acceleration_is_extrapolated_exactly(age):
    state, motion, age_s = received([1.0, 1.01], 1.01 + age)
    now = extrapolated(state, motion, age_s, DT)
    position, velocity, acceleration = moving(1.01 + age)
    np.testing.assert_allclose(now.position, position, atol=1e-12)
    np.testing.assert_allclose(now.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(now.acceleration, acceleration, atol=1e-10)


def test_a_lost_message_costs_nothing_under_constant_acceleration():
    _, motion, _ = received([1.0, 1.05], 1.06)
    np.testing.assert_allclose(motion.acceleration, moving(0.0)[2], atol=1e-10)


def test_the_same_message_again_changes_nothing():
    state, motion, _ = received([1.0, 1.01], 1.02)
    again = neighbour_motion(motion, state, 0.01, 1.02, STALE_S, LIMIT)
    np.testing.assert_array_equal(again.acceleration, motion.acceleration)
    assert again.time == motion.time


@pytest.mark.parametrize("stamp", [0.2, 1.01 + STALE_S + 0.01])
def test_after_a_restart_of_time_or_a_silence_the_acceleration_is_unknown(stamp):
    _, motion, _ = received([1.0, 1.01], 1.02)
    state = message(np.zeros(3), np.array([9.0, 9.0, 9.0]))
    after = neighbour_motion(motion, state, 0.0, stamp, STALE_S, LIMIT)
    np.testing.assert_array_equal(after.acceleration, np.zeros(3))


def test_nothing_received_stays_unknown():
    after = neighbour_motion(laws.UNKNOWN, np.zeros(13), NEVER_RECEIVED_S, 3.0, STALE_S, LIMIT)
    assert after.time == laws.UNKNOWN.time


@given(jump=st.floats(-1e3, 1e3))
def test_the_acceleration_is_bounded(jump):
    before = NeighbourMotion(np.zeros(3), 1.0, np.zeros(3))
    state = message(np.zeros(3), np.array([jump, 0.0, 0.0]))
    after = neighbour_motion(before, state, 0.0, 1.01, STALE_S, LIMIT)
    assert np.linalg.norm(after.acceleration) <= LIMIT * (1 + 1e-12)


@pytest.mark.parametrize(("lag", "share"), [(0.0, 1.0), (4.9, 1.0), (10.0, 0.5), (500.0, 0.01)])
def test_a_vehicle_that_does_not_follow_its_command_reports_what_it_measures(lag, share):
    measured = np.array([1.0, 2.0, -0.5])
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    own = message(np.zeros(3), measured)
    reported = reported_velocity(own, measured + lag * direction, LIMIT)
    said = own.copy()
    said[7:10] = reported
    np.testing.assert_allclose(velocity_enu(said), measured + share * lag * direction, atol=1e-9)
    assert math.isclose(laws._RESPONSE_S * LIMIT, 5.0)
