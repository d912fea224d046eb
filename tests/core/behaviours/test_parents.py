"""Several parents as one: what the mean gives, and what it does to their errors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.behaviours import parents as laws
from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, velocity_enu
from ptnsbc_core.types import NEVER_RECEIVED_S

STALE_S = 0.5
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
