"""The position estimator on board: its error as the theory of its filter has it, and its lag."""

import numpy as np
import pytest

from ptnsbc_core.kinematics import quaternion_from_euler, velocity_enu
from ptnsbc_sim.disturbances.noise import (
    EXACT,
    Gusts,
    PositionNoise,
    SensorNoise,
    add_sensor_noise,
    gust_step,
    gusts_of,
    initial_error,
    measured_odometry,
    position_noise_of,
    position_std_m,
)
from ptnsbc_sim.scenario import load_scenario

HZ, DT = 100, 0.01
NOISE, SHAKE, RATE = 0.02, 0.05, 10


def told(truth: np.ndarray, kind: PositionNoise, draws: np.ndarray) -> np.ndarray:
    """Odometry (T, 13) that a UAV sees of a true track (T, 13)."""
    error = initial_error(kind)
    seen = np.empty_like(truth)
    for tick in range(len(truth)):
        late, reckoned = (
            truth[max(tick - ago, 0), 0:3].copy() for ago in (kind.delay, kind.compensated)
        )
        seen[tick] = measured_odometry(
            truth[tick].copy(), late, reckoned, error, draws[tick], tick, DT, kind
        )
    return seen


def kind_of(delay: int, known: int) -> PositionNoise:
    fixes = {"noise_m": NOISE, "rate_hz": RATE, "acceleration_noise_m_s2": SHAKE}
    late = {"latency_s": delay / HZ, "unknown_latency_s": (delay - known) / HZ}
    scenario = load_scenario("paper_5_free", {"sensor.positioning": {**fixes, **late}})
    return position_noise_of(scenario)


def moving(ticks: int, speed: np.ndarray) -> np.ndarray:
    truth = standing(ticks)
    truth[:, 0:3] = np.outer(np.arange(ticks) * DT, speed)
    truth[:, 7:10] = speed
    return truth


def standing(ticks: int) -> np.ndarray:
    truth = np.zeros((ticks, 13))
    truth[:, 6] = 1.0
    return truth


def test_without_positioning_it_is_exact() -> None:
    truth = standing(1)
    truth[0, :3] = 1.0, 2.0, 3.0
    seen = told(truth, EXACT, np.ones((1, 6)))
    assert seen.tobytes() == truth.tobytes()


def test_error_has_the_variance_of_the_steady_state_filter() -> None:
    """Just after a fix the variance of the position is alpha sigma^2 (Kalata)."""
    ticks = 60_000
    kind = kind_of(0, 0)
    seen = told(standing(ticks), kind, np.random.default_rng(5).standard_normal((ticks, 6)))
    after = seen[1000 :: HZ // RATE, 0:3]
    assert after.std() == pytest.approx(NOISE * np.sqrt(kind.alpha), rel=0.04)
    assert after.std() < 0.6 * NOISE
    assert abs(after.mean()) < 0.001
    assert 0.0 < kind.beta_1_s / RATE < kind.alpha < 1.0


def test_velocity_is_the_rate_of_the_position_between_fixes() -> None:
    kind = kind_of(0, 0)
    truth = standing(500)
    truth[:, 3:7] = quaternion_from_euler(
        np.array([0.3, -0.2, 2.0])
    )  # the twist is in the body frame
    seen = told(truth, kind, np.random.default_rng(2).standard_normal((500, 6)))
    for tick in range(405, 408):
        mean = 0.5 * np.add(velocity_enu(seen[tick]), velocity_enu(seen[tick + 1]))
        step = (seen[tick + 1, 0:3] - seen[tick, 0:3]) / DT
        np.testing.assert_allclose(step, mean, atol=1e-9)
    np.testing.assert_array_equal(seen[:, 3:7], truth[:, 3:7])
    np.testing.assert_array_equal(seen[:, 10:13], truth[:, 10:13])


def test_what_is_not_known_of_the_latency_lags_by_velocity_times_that() -> None:
    ticks, speed = 6000, np.array([1.0, -0.5, 0.2])
    truth = moving(ticks, speed)
    for known, lag_s in ((0, 0.05), (2, 0.03), (5, 0.0)):
        seen = told(truth, kind_of(5, known), np.zeros((ticks, 6)))
        np.testing.assert_allclose(seen[-1, 0:3] - truth[-1, 0:3], -lag_s * speed, atol=1e-6)
        np.testing.assert_allclose(seen[-1, 7:10], speed, atol=1e-6)


@pytest.mark.parametrize("late", [3, 5, 10, 14])
def test_with_the_latency_known_the_motion_does_not_matter(late: int) -> None:
    """The error is that of noise alone, the same for a UAV that stands and one that swings about."""
    ticks = 400
    draws = np.random.default_rng(3).standard_normal((ticks, 6))
    swinging = standing(ticks)
    swinging[:, 0] = 3.0 * np.sin(0.02 * np.arange(ticks))
    errors = [
        told(truth, kind_of(late, late), draws)[:, 0:3] - truth[:, 0:3]
        for truth in (standing(ticks), swinging)
    ]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)
    assert np.abs(errors[0]).max() > 0.005


def test_late_fixes_correct_the_past_and_the_present_follows() -> None:
    """The same by hand: go back to the instant of the fix, correct there, go forward again."""
    late, ticks = 5, 200
    draws = np.random.default_rng(8).standard_normal((ticks, 6))
    kind = kind_of(late, late)
    seen = told(standing(ticks), kind, draws)
    a = np.zeros((ticks, 3))
    for tick in range(ticks):
        measured = (tick + late) % kind.period == 0
        a[tick] = SHAKE * draws[tick, 3:6] if measured else a[tick - 1] if tick else 0.0

    def forward(p: np.ndarray, v: np.ndarray, first: int, last: int) -> tuple[np.ndarray, ...]:
        for tick in range(max(first, 0), last):
            p, v = p + DT * v + 0.5 * DT * DT * a[tick], v + DT * a[tick]
        return p, v

    p, v, since = np.zeros(3), np.zeros(3), -late
    for tick in range(0, ticks, kind.period):
        p, v = forward(p, v, since, tick - late)
        miss = NOISE * draws[tick, 0:3] - p
        p, v, since = p + kind.alpha * miss, v + kind.beta_1_s * miss, tick - late
        now, _ = forward(p, v, since, tick)
        np.testing.assert_allclose(seen[tick, 0:3], now, atol=1e-12)


def test_spread_is_that_of_the_steady_kalman_filter_carried_to_the_present() -> None:
    """Riccati's equation gives the covariance, a long run the same spread."""
    transition, push = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    square = NOISE**2
    before = np.eye(2)
    for _ in range(2000):
        gain = before[:, :1] / (before[0, 0] + square)
        after = before - gain @ before[:1]
        before = transition @ after @ transition.T + SHAKE**2 * push @ push.T
    aged = np.array([[1.0, 0.05], [0.0, 1.0]])
    pushed = np.array([[0.5 * 0.05**2], [0.05]])
    wanted = aged @ after @ aged.T + SHAKE**2 * pushed @ pushed.T
    assert position_std_m(kind_of(5, 5), DT) == pytest.approx(np.sqrt(wanted[0, 0]), rel=1e-6)
    assert kind_of(0, 0).alpha == pytest.approx(gain[0, 0], rel=1e-6)

    ticks = 60_000
    draws = np.random.default_rng(6).standard_normal((ticks, 6))
    found = told(standing(ticks), kind_of(5, 5), draws)[1000 :: HZ // RATE, 0:3].std()
    assert found == pytest.approx(position_std_m(kind_of(5, 5), DT), rel=0.04)


NEAR = np.array([[1.0, 2.0, 3.0, 0.5, 0.125, 0.25, 0.375]])
STILL = np.zeros(6)


def vehicle(position: tuple[float, ...], velocity: tuple[float, ...]) -> np.ndarray:
    out = np.zeros(13)
    out[0:3], out[7:10] = position, velocity
    out[3:7] = quaternion_from_euler(np.array([0.2, -0.1, 1.0]))
    return out


def test_distance_and_motion_against_the_uav_stay_true() -> None:
    truth, seen = vehicle((0, 0, 0), (1, 0, 0)), vehicle((0.03, -0.02, 0.01), (1.1, -0.05, 0.02))
    moved = add_sensor_noise(NEAR, truth, seen, STILL, SensorNoise(0.0, 0.0))
    np.testing.assert_allclose(moved[0, :3] - seen[:3], NEAR[0, :3] - truth[:3], atol=1e-6)
    np.testing.assert_allclose(
        moved[0, 4:] - velocity_enu(seen), NEAR[0, 4:] - velocity_enu(truth), atol=1e-6
    )
    assert moved[0, 3] == NEAR[0, 3]
    assert (
        add_sensor_noise(NEAR, truth, truth, STILL, SensorNoise(0.0, 0.0)).tobytes()
        == NEAR.tobytes()
    )


def test_noise_is_as_wide_as_asked_for_and_its_own_for_every_object() -> None:
    truth, near = vehicle((0, 0, 0), (0, 0, 0)), np.repeat(NEAR, 4000, axis=0)
    draws = np.random.default_rng(4).standard_normal(6 * len(near))
    off = add_sensor_noise(near, truth, truth, draws, SensorNoise(0.01, 0.03)) - near
    assert off[:, :3].std() == pytest.approx(0.01, rel=0.03)
    assert off[:, 4:].std() == pytest.approx(0.03, rel=0.03)
    assert (off[:, 3] == 0.0).all()
    assert np.corrcoef(off[:-1, 0], off[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.05)


TIME = 2.0


def kind_of_wind(mean: list[float], gust: list[float]) -> Gusts:
    keys = {"world.wind_m_s": mean, "world.gust_m_s": gust, "world.gust_time_s": TIME}
    return gusts_of(load_scenario("paper_5_free", keys))


GUSTY = kind_of_wind([1.6, 1.2, 0.0], [0.7, 0.7, 0.0])


def wind(ticks: int, seed: int = 1) -> np.ndarray:
    draws = np.random.default_rng(seed).standard_normal((ticks, 3))
    gust, out = np.zeros(3), np.empty((ticks, 3))
    for tick in range(ticks):
        gust_step(gust, out[tick], draws[tick], tick, GUSTY)
    return out


def test_mean_deviation_and_correlation() -> None:
    found = wind(200_000)
    np.testing.assert_allclose(found.mean(axis=0), [1.6, 1.2, 0.0], atol=0.15)
    np.testing.assert_allclose(found.std(axis=0), [0.7, 0.7, 0.0], rtol=0.1)
    off = found[:, 0] - found[:, 0].mean()
    later = round(TIME / DT)
    assert np.mean(off[later:] * off[:-later]) / off.var() == pytest.approx(np.exp(-1), abs=0.1)


def test_stationary_from_the_first_tick() -> None:
    first = np.array([wind(1, seed)[0, 0] for seed in range(400)])
    assert first.std() == pytest.approx(0.7, rel=0.15)


def test_none_is_the_mean_to_the_last_bit() -> None:
    mean, out = [2.0, -0.3, 0.1], np.empty(3)
    gust_step(np.zeros(3), out, np.ones(3), 0, kind_of_wind(mean, [0.0, 0.0, 0.0]))
    assert out.tolist() == mean
