"""The turned approach keeps the norm of the straight plan, and without a turn it is the straight plan."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.curves.turned import (
    TURNED,
    Factor,
    goal_factor,
    left_at,
    mean_factor,
    plus_scaled,
    scaled,
    start_of,
    turn_share,
    turn_share_rate,
    turned_step,
)
from ptnsbc_core.timebase import Clock, h, plan_step

TF, DT = 4.5, 0.01

turns = st.floats(-2.0, 2.0)
shares = st.floats(0.0, 1.0)
vectors = st.tuples(*[st.floats(-20.0, 20.0)] * 3)


def flat(factor: Factor) -> complex:
    return complex(factor.along, factor.across)


@given(turn=turns, s=shares, error=vectors)
def test_the_norm_is_that_of_the_straight_plan(turn: float, s: float, error) -> None:
    left = np.linalg.norm(scaled(left_at(turn, s), error))
    assert left == pytest.approx((1.0 - h(s)) * np.linalg.norm(error), abs=1e-12)


@given(turn=turns, s=shares, one=vectors, other=vectors)
def test_the_difference_of_two_is_turned_like_each_of_them(turn: float, s: float, one, other):
    z = left_at(turn, s)
    apart = np.subtract(scaled(z, one), scaled(z, other))
    np.testing.assert_allclose(scaled(z, np.subtract(one, other)), apart, atol=1e-12)


@given(k=st.integers(0, 600), error=vectors, base=vectors)
def test_without_a_turn_it_is_the_straight_plan_to_the_last_bit(k: int, error, base) -> None:
    clock = Clock(k * DT, k * DT, DT)
    plan, turned = plan_step(TF, clock), turned_step(TF, 0.0, clock)
    for number, factor in zip(plan, turned, strict=True):
        assert factor == Factor(number, 0.0, number)
        straight = tuple(b + number * e for b, e in zip(base, error, strict=True))
        assert plus_scaled(1.0, factor, error, base) == straight
        assert scaled(factor, error) == tuple(number * e for e in error)


@given(turn=turns, k=st.integers(0, 449))
def test_a_step_of_the_rate_leads_to_the_plan_after_it(turn: float, k: int) -> None:
    now, after = (turned_step(TF, turn, Clock(j * DT, j * DT, DT)) for j in (k, k + 1))
    for one in range(3):
        assert now.left[one] - DT * now.rate[one] == pytest.approx(after.left[one], abs=1e-13)
        assert now.rate[one] + DT * now.acceleration[one] == pytest.approx(
            after.rate[one], abs=1e-9
        )


@given(turn=turns, s=st.floats(0.02, 0.98))
def test_rate_and_acceleration_are_those_of_the_curve(turn: float, s: float) -> None:
    dt = 1e-4
    step = turned_step(1.0, turn, Clock(s, s, dt))
    z = [flat(left_at(turn, s + j * dt)) for j in (-1, 0, 1, 2)]
    assert flat(step.rate) == pytest.approx((z[0] - z[2]) / (2.0 * dt), abs=5e-3)
    assert flat(step.acceleration) == pytest.approx((2.0 * z[1] - z[0] - z[2]) / dt**2, abs=0.2)


@given(s=st.floats(1e-4, 1.0 - 1e-4))
def test_the_share_of_the_turn_has_its_derivative(s: float) -> None:
    step = 1e-6
    slope = (turn_share(s + step) - turn_share(s - step)) / (2.0 * step)
    assert turn_share_rate(s) == pytest.approx(slope, abs=1e-4)


def test_the_turn_begins_at_rest_and_ends_before_the_plan() -> None:
    assert (turn_share(0.0), turn_share_rate(0.0)) == (0.0, 0.0)
    assert (turn_share(TURNED), turn_share_rate(TURNED)) == (1.0, 0.0)
    assert flat(left_at(1.5, 0.0)) == 1.0
    assert flat(left_at(1.5, 1.0)) == 0.0


@given(turn=turns, s=st.floats(0.0, 0.6), error=vectors)
def test_one_that_joins_late_knows_where_its_plan_began(turn: float, s: float, error) -> None:
    left = left_at(turn, s)
    np.testing.assert_allclose(start_of(left, scaled(left, error)), error, atol=1e-9)


@given(turn=turns, s=st.floats(0.1, 0.9), error=vectors)
def test_place_and_velocity_tell_where_the_plan_ends(turn: float, s: float, error) -> None:
    """g = x + z E_0, and the velocity is -z_dot E_0."""
    step = 1e-6
    there, here = left_at(turn, s + step), left_at(turn, s - step)
    rates = [(a - b) / (2.0 * step) for a, b in zip(here, there, strict=True)]
    velocity = scaled(Factor(*rates), error)
    told = scaled(goal_factor(turn, s * TF, TF), tuple(one / TF for one in velocity))
    np.testing.assert_allclose(told, scaled(left_at(turn, s), error), atol=1e-5)


@given(turn=turns, s=st.floats(0.1, 0.95), horizon=st.floats(0.05, 3.0), error=vectors)
def test_the_mean_over_a_horizon_is_that_of_the_plan(turn: float, s: float, horizon: float, error):
    """As long as it is, and no longer than the present velocity; in the direction that it has."""
    step, t = 1e-6, s * TF
    now, then = left_at(turn, s), left_at(turn, min((t + horizon) / TF, 1.0))
    later, before = left_at(turn, s + step), left_at(turn, s - step)
    velocity = (flat(before) - flat(later)) / (2.0 * step * TF)
    mean = (flat(now) - flat(then)) / horizon
    ratio = mean / velocity
    ratio /= max(abs(ratio), 1.0)
    found = mean_factor(turn, t, TF, horizon)
    assert flat(found) == pytest.approx(ratio, abs=1e-4)
    assert found.up <= 1.0


def test_a_ring_that_changes_sides_keeps_its_distances() -> None:
    """|1 - 2 z| is the distance of two that change places, by the one that they have at the start."""
    s = np.linspace(0.0, 1.0, 1001).tolist()
    for degrees, least in ((0, 0.0), (30, 0.411), (60, 0.801), (90, 0.967)):
        z = np.array([flat(left_at(math.radians(degrees), one)) for one in s])
        assert np.abs(1.0 - 2.0 * z).min() == pytest.approx(least, abs=2e-3)
