"""The position estimator on board: its error as the theory of its filter has it, and its lag."""

import numpy as np
import pytest

from ptnsbc_core.kinematics import quaternion_from_euler, velocity_enu
from ptnsbc_sim.chance.odometer import ERROR_SIZE, Odometer, believed, beside, odometer

HZ, DT = 100, 0.01
NOISE, SHAKE, RATE = 0.02, 0.05, 10


def told(truth: np.ndarray, kind: Odometer, draws: np.ndarray) -> np.ndarray:
    """Odometry (T, 13) that a UAV sees of a true track (T, 13)."""
    error = np.zeros(ERROR_SIZE)
    seen = np.empty_like(truth)
    for tick in range(len(truth)):
        late = truth[max(tick - kind.delay, 0), 0:3].copy()
        seen[tick] = believed(truth[tick].copy(), late, error, draws[tick], tick, DT, kind)
    return seen


def standing(ticks: int) -> np.ndarray:
    truth = np.zeros((ticks, 13))
    truth[:, 6] = 1.0
    return truth


def test_without_positioning_it_is_exact() -> None:
    truth = standing(1)
    truth[0, :3] = 1.0, 2.0, 3.0
    seen = told(truth, Odometer(0, 0, 0.0, 0.0, 0.0, 0.0), np.ones((1, 6)))
    assert seen.tobytes() == truth.tobytes()


def test_error_has_the_variance_of_the_steady_state_filter() -> None:
    """Just after a fix the variance of the position is alpha sigma^2 (Kalata)."""
    ticks = 60_000
    kind = odometer(NOISE, SHAKE, RATE, HZ // RATE, 0)
    seen = told(standing(ticks), kind, np.random.default_rng(5).standard_normal((ticks, 6)))
    after = seen[1000 :: HZ // RATE, 0:3]
    assert after.std() == pytest.approx(NOISE * np.sqrt(kind.alpha), rel=0.04)
    assert after.std() < 0.6 * NOISE
    assert abs(after.mean()) < 0.001
    assert 0.0 < kind.beta_1_s / RATE < kind.alpha < 1.0


def test_velocity_is_the_rate_of_the_position_between_fixes() -> None:
    kind = odometer(NOISE, SHAKE, RATE, HZ // RATE, 0)
    truth = standing(500)
    truth[:, 3:7] = quaternion_from_euler(
        np.array([0.3, -0.2, 2.0])
    )  # the twist is in the body frame
    seen = told(truth, kind, np.random.default_rng(2).standard_normal((500, 6)))
    for tick in range(405, 408):
        mean = 0.5 * (velocity_enu(seen[tick]) + velocity_enu(seen[tick + 1]))
        step = (seen[tick + 1, 0:3] - seen[tick, 0:3]) / DT
        np.testing.assert_allclose(step, mean, atol=1e-9)
    np.testing.assert_array_equal(seen[:, 3:7], truth[:, 3:7])
    np.testing.assert_array_equal(seen[:, 10:13], truth[:, 10:13])


def test_at_constant_velocity_it_lags_by_velocity_times_latency() -> None:
    ticks, speed = 6000, np.array([1.0, -0.5, 0.2])
    truth = standing(ticks)
    truth[:, 0:3] = np.outer(np.arange(ticks) * DT, speed)
    truth[:, 7:10] = speed
    seen = told(truth, odometer(NOISE, SHAKE, RATE, HZ // RATE, 5), np.zeros((ticks, 6)))
    np.testing.assert_allclose(seen[-1, 0:3] - truth[-1, 0:3], -0.05 * speed, atol=1e-6)
    np.testing.assert_allclose(seen[-1, 7:10], speed, atol=1e-6)


def test_near_objects_keep_their_distance_from_the_uav() -> None:
    truth, seen = standing(1)[0], standing(1)[0]
    seen[0:3] = 0.03, -0.02, 0.01
    near = np.array([[1.0, 2.0, 3.0, 0.5, 0.125, 0.25, 0.375]])
    moved = beside(near, truth, seen)
    np.testing.assert_allclose(moved[0, :3] - seen[:3], near[0, :3] - truth[:3], atol=1e-6)
    np.testing.assert_array_equal(moved[:, 3:], near[:, 3:])
    np.testing.assert_array_equal(moved, moved.astype(np.float32))
