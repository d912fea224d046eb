"""Gain and lag of a vehicle from its flight."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_nodes.bridge.setpoint.following import Following, FollowingEstimator

PERIOD_S = 0.02


def wanted(t):
    """A path with several periods, as a formation flies them [m/s]."""
    return np.array([0.5 * math.sin(0.7 * t), 0.4 * math.cos(0.9 * t) + 0.2, 0.3])


def told(seconds, gain=1.0, lag_s=0.0, noise=0.0, path=wanted, start=100.0):
    random = np.random.default_rng(2)
    made = FollowingEstimator()
    for n in range(round(seconds / PERIOD_S)):
        t = start + n * PERIOD_S
        flown = gain * path(t - lag_s) + noise * random.standard_normal(3)
        made.add(t, path(t), flown)
    return made.found()


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.2])
@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.5])
def test_gain_and_lag_are_found_in_noise(gain, lag_s):
    found = told(25.0, gain, lag_s, noise=0.05)
    assert found.gain == pytest.approx(gain, rel=0.05)
    assert found.lag_s == pytest.approx(lag_s, abs=0.051)


@pytest.mark.parametrize("path", [lambda _: np.zeros(3), lambda _: np.array([1.0, 0.5, 0.0])])
def test_a_vehicle_that_does_not_change_its_velocity_shows_nothing(path):
    assert told(25.0, path=path) is None


def test_a_few_seconds_show_nothing():
    assert told(9.0) is None


def test_a_gap_begins_anew():
    made = FollowingEstimator()
    for n in range(1000):
        t = n * PERIOD_S
        made.add(t, wanted(t), wanted(t))
    made.add(30.0, wanted(30.0), wanted(30.0))
    assert made.found() is None


def test_only_the_last_half_minute_counts():
    made = FollowingEstimator()
    for n in range(3500):
        t = n * PERIOD_S
        made.add(t, wanted(t), wanted(t) * (0.5 if t < 35.0 else 1.0))
    assert made.found().gain == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(
    ("gain", "lag_s", "near"),
    [(1.0, 0.1, True), (1.25, 0.3, True), (0.6, 0.1, False), (1.0, 0.5, False)],
)
def test_a_vehicle_unlike_the_prediction_is_told(gain, lag_s, near):
    assert (Following(gain, lag_s).unlike == "") is near
    assert near or f"gain {gain:.2f}, {lag_s:.2f} s late" in Following(gain, lag_s).unlike
