"""Kinematics (1)-(6): a rotation matrix that is one, W by finite differences, and the accessors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import tuples
from scipy.spatial.transform import Rotation

from ptnsbc_core.kinematics import (
    body_rates,
    euler_from_rotation,
    euler_rates,
    is_estimate,
    move_to_present,
    odometry_to_estimate,
    quaternion_from_euler,
    rotation_from_euler,
    rotation_from_quaternion,
    state_to_estimate,
    store_estimate,
    velocity_enu,
    yaw_of,
)
from ptnsbc_core.types import Estimate

ONES = np.ones(3)
angle = st.floats(-np.pi, np.pi)
eulers = st.tuples(angle, st.floats(-1.5, 1.5), angle).map(np.array)
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def printed_rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(2) as printed, reading the angle that stands twice as the yaw wherever that helps it."""
    cf, sf, ct, st_ = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cp, sp = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [ct * cp, cp * st_ * sf - sp * cf, cp * st_ * cf + sp * sf],
            [ct * sp, sp * st_ * sf + cp * cf, sp * st_ * cf + cp * sf],
            [-st_, sf * ct, cf * ct],
        ]
    )


@given(euler=st.tuples(angle, angle, angle).map(np.array))
def test_rotation_is_orthonormal_at_all_attitudes(euler: np.ndarray) -> None:
    r = rotation_from_euler(euler)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(r) == pytest.approx(1.0)
    expected = Rotation.from_euler("ZYX", euler[::-1]).as_matrix()
    np.testing.assert_allclose(r, expected, atol=1e-14)
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion_from_euler(euler)), expected, atol=1e-14
    )


def test_printed_rotation_is_none() -> None:
    r = printed_rotation(1.0, 1.0, 1.0)
    assert np.abs(r @ r.T - np.eye(3)).max() == pytest.approx(0.867, abs=1e-3)
    corrected = r.copy()
    corrected[1, 2] = np.sin(1.0) * np.sin(1.0) * np.cos(1.0) - np.cos(1.0) * np.sin(1.0)
    np.testing.assert_allclose(rotation_from_euler(ONES), corrected, atol=1e-15)


def test_rotation_by_hand() -> None:
    """A quarter turn of yaw takes forward to the north, pitch down takes forward to the ground."""
    quarter = np.pi / 2
    forward = np.array([1.0, 0.0, 0.0])
    turned = rotation_from_euler(np.array([0.0, 0.0, quarter])) @ forward
    np.testing.assert_allclose(turned, [0.0, 1.0, 0.0], atol=1e-15)
    dived = rotation_from_euler(np.array([0.0, quarter, 0.0])) @ forward
    np.testing.assert_allclose(dived, [0.0, 0.0, -1.0], atol=1e-15)


@given(euler=eulers)
def test_euler_angles_come_back(euler: np.ndarray) -> None:
    np.testing.assert_allclose(euler_from_rotation(rotation_from_euler(euler)), euler, atol=1e-12)


@pytest.mark.slow
@given(euler=eulers, rates=vectors)
def test_w_and_its_inverse(euler: np.ndarray, rates: np.ndarray) -> None:
    np.testing.assert_allclose(body_rates(euler, euler_rates(euler, rates)), rates, atol=1e-11)
    np.testing.assert_allclose(euler_rates(euler, body_rates(euler, rates)), rates, atol=1e-11)


@given(euler=st.tuples(angle, st.floats(-1.2, 1.2), angle).map(np.array), rates=vectors)
def test_w_by_finite_differences_of_the_attitude(euler: np.ndarray, rates: np.ndarray) -> None:
    step = 1e-6

    def after(t: float) -> np.ndarray:
        r = rotation_from_euler(euler) @ Rotation.from_rotvec(t * rates).as_matrix()
        return np.array(euler_from_rotation(r))

    moved = after(step) - after(-step)
    moved = (moved + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(euler_rates(euler, rates), moved / (2.0 * step), atol=1e-7)


def test_w_by_hand() -> None:
    """Level, W is the identity; rolled by 90 degrees, a pitch rate of the body is all yaw."""
    np.testing.assert_allclose(euler_rates(np.zeros(3), np.array([1.0, 2, 3])), [1, 2, 3])
    rolled = np.array([np.pi / 2, 0.0, 0.0])
    np.testing.assert_allclose(euler_rates(rolled, np.array([0.0, 1, 0])), [0, 0, 1], atol=1e-15)


def test_theta_inverse_twice_turns_a_command_by_76_degrees() -> None:
    """(30) and (37) both apply it: at (1, 1, 1) a command across the axis of R turns by R's angle."""
    r = rotation_from_euler(ONES)
    axis = Rotation.from_matrix(r).as_rotvec()
    command = np.cross(axis, [0.0, 0.0, 1.0])
    once, twice = r.T @ command, r.T @ (r.T @ command)
    turned = np.arccos(once @ twice / (command @ command))
    assert np.degrees(turned) == pytest.approx(76.36, abs=0.01)
    # applied once it is the body-frame velocity of the command: the odometry gives it back
    own = np.zeros(13)
    own[3:7] = quaternion_from_euler(ONES)
    own[7:10] = once
    np.testing.assert_allclose(velocity_enu(own), command, atol=1e-14)


@given(euler=eulers, position=vectors, velocity=vectors)
def test_accessors_of_an_odometry_vector(
    euler: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> None:
    own = np.zeros(13)
    own[0:3] = position
    own[3:7] = quaternion_from_euler(euler)
    own[7:10] = velocity
    world = rotation_from_euler(euler) @ velocity
    np.testing.assert_allclose(velocity_enu(own), world, atol=1e-13)
    off = (yaw_of(own) - euler[2] + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(off) < 1e-12
    estimate = state_to_estimate(own)
    np.testing.assert_array_equal(estimate.position, position)
    assert estimate.velocity == velocity_enu(own)
    assert estimate.yaw == yaw_of(own)


@given(euler=eulers, position=vectors, velocity=vectors, rates=vectors, age_s=st.floats(0.0, 0.5))
def test_a_vehicle_moves_on_by_its_twist(
    euler: np.ndarray, position: np.ndarray, velocity: np.ndarray, rates: np.ndarray, age_s: float
) -> None:
    turned = Rotation.from_euler("xyz", euler)
    own = np.concatenate((position, turned.as_quat(), velocity, rates))
    world = turned.apply(velocity)
    move_to_present(own, age_s)
    np.testing.assert_allclose(own[0:3], position + age_s * world, atol=1e-13)
    by_now = turned * Rotation.from_rotvec(age_s * rates)
    np.testing.assert_allclose(
        (by_now.inv() * Rotation.from_quat(own[3:7])).magnitude(), 0.0, atol=1e-7
    )
    assert np.linalg.norm(own[3:7]) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(velocity_enu(own), world, atol=1e-13)
    np.testing.assert_array_equal(own[10:13], rates)


@given(position=vectors, velocity=vectors, yaw=st.floats(-3.1, 3.1))
def test_an_estimate_survives_the_message(
    position: np.ndarray, velocity: np.ndarray, yaw: float
) -> None:
    message = np.empty(13)
    store_estimate(message, Estimate(tuples(position), tuples(velocity), yaw), True)
    assert np.linalg.norm(message[3:7]) == pytest.approx(1.0)
    back = odometry_to_estimate(message)
    np.testing.assert_array_equal(back.position, position)
    np.testing.assert_array_equal(back.velocity, velocity)
    assert back.yaw == pytest.approx(yaw, abs=1e-14)
    assert is_estimate(message)
    store_estimate(message, Estimate(tuples(position), tuples(velocity), yaw), False)
    assert np.linalg.norm(message[3:7]) == 1.0
    assert not is_estimate(message)
