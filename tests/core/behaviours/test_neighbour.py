"""The motion of a neighbour: told and a little later, seen by the own sensor, and of several as of one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.behaviours import neighbour as laws
from ptnsbc_core.behaviours.neighbour import Neighbour, associate
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


COORDINATE = st.floats(-20.0, 20.0)
VECTORS = st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=2, max_size=5)


def messages(positions, velocities):
    """Odometry vectors (P, 13) with velocities given in the world, each with another attitude."""
    states = np.zeros((len(positions), 13))
    for k, state in enumerate(states):
        attitude = quaternion_from_euler(np.array([0.1 * k, -0.2, 0.7 * k]))
        state[0:3], state[3:7] = positions[k], attitude
        state[7:10] = rotation_from_quaternion(attitude).T @ velocities[k]
    return states


def mean_of(states, ages, weights, shifts):
    mean = np.full(13, math.nan)
    shifts = np.ascontiguousarray(shifts)
    age_s = laws.mean_parent(states, np.asarray(ages), weights, shifts, STALE_S, mean)
    return mean, age_s


def convex(count, seed):
    return np.random.default_rng(seed).dirichlet(np.ones(count))


@given(VECTORS, st.integers(0, 1000))
def test_parents_in_their_slots_are_one_parent_in_the_slot_of_the_first(slots, seed):
    slots, leader, velocity = np.array(slots), np.array([3.0, -2.0, 8.0]), np.array([1.0, 2.0, 0.1])
    states = messages(leader + slots, np.tile(velocity, (len(slots), 1)))
    ages, weights = np.full(len(slots), 0.02), convex(len(slots), seed)
    mean, age_s = mean_of(states, ages, weights, slots[0] - slots)
    np.testing.assert_allclose(mean[:3], leader + slots[0], atol=1e-12)
    np.testing.assert_allclose(velocity_enu(mean), velocity, atol=1e-12)
    assert age_s == pytest.approx(0.02)


@given(VECTORS, st.integers(0, 1000))
def test_no_mean_deviates_more_than_the_worst_parent(errors, seed):
    """The weights are convex: nothing is amplified."""
    errors = np.array(errors)
    ages, weights = np.zeros(len(errors)), convex(len(errors), seed)
    mean, _ = mean_of(messages(errors, errors), ages, weights, np.zeros_like(errors))
    worst = np.linalg.norm(errors, axis=1).max()
    assert np.linalg.norm(mean[:3]) <= worst + 1e-12
    assert np.linalg.norm(velocity_enu(mean)) <= worst + 1e-12


@given(st.integers(2, 5), st.integers(0, 1000))
def test_independent_errors_are_reduced_by_the_root_of_the_squared_weights(count, seed):
    weights, none = convex(count, seed), np.zeros((count, 3))
    shares = np.zeros((count, 3))
    for k in range(count):
        unit = none.copy()
        unit[k] = 1.0
        shares[k] = mean_of(messages(unit, none), np.zeros(count), weights, none)[0][:3]
    variance = (shares**2).sum(axis=0)  # of unit variance in each parent and axis
    np.testing.assert_allclose(variance, (weights**2).sum(), atol=1e-12)
    assert (variance <= 1.0).all()


@pytest.mark.parametrize(("late_s", "share"), [(0.0, 0.5), (0.05, 0.5), (0.15, 1 / 3), (0.25, 0.0)])
def test_the_weight_of_a_silent_parent_goes_to_the_others(late_s, share):
    states = messages(np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.zeros((2, 3)))
    weights, shifts = np.array([0.5, 0.5]), np.zeros((2, 3))
    mean, age_s = mean_of(states, [0.02, 0.02 + late_s], weights, shifts)
    assert mean[0] == pytest.approx(share)
    assert age_s == pytest.approx(0.02 + share * late_s)


def test_without_any_message_there_is_no_parent():
    never = [NEVER_RECEIVED_S, NEVER_RECEIVED_S]
    _, age_s = mean_of(np.zeros((2, 13)), never, np.array([0.5, 0.5]), np.zeros((2, 3)))
    assert age_s == NEVER_RECEIVED_S
    _, age_s = mean_of(np.zeros((2, 13)), [0.1, never[0]], np.array([0.5, 0.5]), np.zeros((2, 3)))
    assert age_s == pytest.approx(0.1)


def test_compiled_and_interpreted_give_the_same_bits():
    interpreted = getattr(laws.mean_parent, "py_func", laws.mean_parent)
    rng = np.random.default_rng(5)
    states = messages(rng.normal(size=(3, 3)), rng.normal(size=(3, 3)))
    found = []
    for law in (laws.mean_parent, interpreted):
        mean = np.empty(13)
        age_s = law(states, np.array([0.0, 0.1, 0.2]), convex(3, 1), states[:, :3], STALE_S, mean)
        found.append((age_s, mean.tobytes()))
    assert found[0] == found[1]


associate = on_arrays(associate)

REPORTED = Neighbour(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 0.0]), np.zeros(3), 0.0)
NOTHING = np.empty((0, 7))


def row(x: float, y: float, z: float, *velocity: float) -> list[float]:
    return [x, y, z, 0.5, *(velocity or (0.0, 0.0, 0.0))]


def same(a: Neighbour, b: Neighbour) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize(
    ("near", "gate_m"),
    [(NOTHING, 0.2), (np.array([row(1.3, 2, 3)]), 0.2), (np.array([row(1.01, 2, 3)]), 0.0)],
)
def test_without_anything_close_enough_a_neighbour_is_where_it_says(near, gate_m) -> None:
    assert same(associate(REPORTED, near, 0.0, gate_m), REPORTED)


def test_the_nearest_one_is_taken_and_moved_on_by_its_age() -> None:
    near = np.array([row(1.15, 2, 3), row(0.95, 2, 3, 1.0, 2.0, 0.0), row(-4, 0, 0)])
    seen = associate(REPORTED, near, 0.02, 0.2)
    np.testing.assert_allclose(seen.position, (0.97, 2.04, 3.0), atol=1e-12)
    np.testing.assert_allclose(seen.velocity, (1.0, 2.0, 0.0))


def test_the_sensor_s_age_counts_in_the_choice() -> None:
    near = np.array([row(0.7, 2, 3, 3.0, 0.0, 0.0), row(1.15, 2, 3)])
    assert associate(REPORTED, near, 0.1, 0.2).position[0] == pytest.approx(1.0)
    assert associate(REPORTED, near, 0.0, 0.2).position[0] == pytest.approx(1.15)


def test_the_own_error_cancels_in_the_difference() -> None:
    """Seen from a believed place, a neighbour is as far away as it really is, whatever it says of itself."""
    own, other = np.zeros(3), np.array([1.2, -0.6, 0.1])
    own_error, its_error = np.array([0.02, -0.03, 0.01]), np.array([-0.04, 0.01, 0.02])
    near = np.array([row(*(other + own_error))])
    reported = Neighbour(other + its_error, np.zeros(3), np.zeros(3), 0.0)
    seen = associate(reported, near, 0.0, 0.2).position - (own + own_error)
    np.testing.assert_allclose(seen, other - own, atol=1e-12)
    assert np.linalg.norm((reported.position - (own + own_error)) - (other - own)) > 0.05
