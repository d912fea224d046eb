"""The velocity of a vehicle that reports positions alone."""

import numpy as np
import pytest

from ptnsbc_nodes.bridge.ros_vehicle.velocity_filter import TIME_CONSTANT_S, VelocityFilter

ACCELERATION = np.array([2.0, -1.0, 0.5])


def lag_s(period_s):
    """By the closed form."""
    q = np.exp(-period_s / TIME_CONSTANT_S)
    return period_s * (1 + 3 * q) / (2 * (1 - q))


@pytest.mark.parametrize("period_s", [0.005, 0.01, 0.02, 1 / 30, 0.1])
def test_the_velocity_of_an_acceleration_is_late_by_the_closed_form(period_s):
    estimator = VelocityFilter()
    for t in np.arange(0.0, 4.0, period_s):
        velocity = estimator.update(t, 0.5 * t * t * ACCELERATION)
    assert velocity == pytest.approx((t - lag_s(period_s)) * ACCELERATION, rel=1e-6)
    assert lag_s(0.001) == pytest.approx(2 * TIME_CONSTANT_S, rel=0.02)


def test_a_millimetre_of_noise_is_a_centimetre_per_second():
    estimator, random = VelocityFilter(), np.random.default_rng(1)
    found = [estimator.update(0.01 * k, random.normal(0.0, 0.001, 3)).copy() for k in range(3000)]
    assert np.std(found[50:]) == pytest.approx(0.0124, rel=0.1)


def test_old_positions_change_nothing_and_a_gap_begins_anew():
    estimator = VelocityFilter()
    for k in range(100):
        estimator.update(0.01 * k, 0.01 * k * np.ones(3))
    before = estimator.update(0.5, np.zeros(3))
    assert before == pytest.approx(np.ones(3))
    assert estimator.update(2.0, np.zeros(3)).tolist() == [0.0, 0.0, 0.0]
