"""The turned approach keeps the norm of the straight plan, and without a turn it is the straight plan."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.curves.turned import (
    TURNED,
    Factor,
    ToldPaths,
    goal_factor,
    left_at,
    mean_factor,
    path_share,
    plus_scaled,
    scaled,
    start_of,
    turn_share,
    turn_share_rate,
    turned_step,
)
from ptnsbc_core.timebase import Clock, h, h_rate, plan_step

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


path_share = on_arrays(path_share)

PLAN_S = 5.0
SLOTS = np.array([[0, 0, 0, 0.6], [-1.2, 1, 0, 0.7], [-1.2, -1, 0, 0.7], [-2.4, 0, 0, 0.7]])
OWN, REACH = np.array([1.5, 0, 0]), 0.75

seeds = st.integers(0, 2**31)
times = st.floats(0.3, 4.6)
horizons = st.floats(0.05, 4.0)


class Pair:
    """Two UAVs on their planned approach behind a leader that moves, the other one at a slot of SLOTS."""

    def __init__(self, seed: int, t: float, turn: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.leader, self.leader_velocity = rng.normal(size=(2, 3))
        self.starts = 4.0 * rng.normal(size=(2, 3))
        self.slots = np.stack([OWN, SLOTS[rng.integers(len(SLOTS)), :3]])
        self.told = ToldPaths(t, PLAN_S, self.leader, self.leader_velocity, OWN, SLOTS, REACH, turn)
        left, rate = 1.0 - h(t / PLAN_S), h_rate(t / PLAN_S, PLAN_S)
        dt = 1e-6
        self.positions = self.leader + self.places(t)
        self.velocities = self.leader_velocity + (self.places(t + dt) - self.places(t - dt)) / (
            2.0 * dt
        )
        self.goal_moves = left / rate  # by so much for 1 m/s

    def places(self, t: float) -> np.ndarray:
        """Planned positions (2, 3) beside the leader."""
        z = left_at(self.told.turn, t / PLAN_S)
        errors = self.slots - self.starts
        return self.slots - np.array([scaled(z, tuple(one)) for one in errors])

    def apart(self, t: float) -> np.ndarray:
        """Planned vector between the two at a later instant."""
        own, other = self.places(t)
        return own - other

    def share(self, horizon: float, off_m=(0.0, 0.0, 0.0)) -> float:
        """With a velocity of the other one whose goal is so far from its slot."""
        return self.factor(horizon, off_m).up

    def factor(self, horizon: float, off_m=(0.0, 0.0, 0.0)) -> Factor:
        off = np.asarray(off_m) / self.goal_moves
        place, velocity = self.positions, self.velocities
        told = self.told
        return Factor(
            *path_share(told, place[0], velocity[0], place[1], velocity[1] + off, horizon)
        )


@given(seed=seeds, t=times, horizon=horizons)
def test_on_their_paths_it_is_the_mean_of_the_plan(seed: int, t: float, horizon: float) -> None:
    """Never more than the present velocity: the told path takes constraints back and adds none."""
    pair = Pair(seed, t)
    planned = (pair.apart(t + horizon) - pair.apart(t)) / horizon
    now = pair.velocities[0] - pair.velocities[1]
    share = pair.share(horizon)
    assert share == pytest.approx(min(np.linalg.norm(planned) / np.linalg.norm(now), 1.0), rel=1e-6)
    if share < 1.0:
        np.testing.assert_allclose(share * now, planned, atol=1e-6)


@given(seed=seeds, t=times, horizon=horizons, turn=st.floats(-1.5, 1.5))
def test_on_turned_paths_it_is_the_mean_of_the_plan_too(seed, t, horizon, turn) -> None:
    """In its direction, and no longer than the present velocity."""
    pair = Pair(seed, t, turn)
    planned = (pair.apart(t + horizon) - pair.apart(t)) / horizon
    now = pair.velocities[0] - pair.velocities[1]
    along, flat = np.linalg.norm(planned[:2]), np.linalg.norm(now[:2])
    expected = planned[:2] * min(1.0, flat / along) if along > 0.0 else planned[:2]
    told = scaled(pair.factor(horizon), tuple(now))
    np.testing.assert_allclose(told[:2], expected, atol=2e-4)


@given(seed=seeds, t=times, horizon=horizons, off=st.floats(0.0, 2.0))
def test_with_the_deviation_the_present_velocity_returns_continuously(
    seed: int, t: float, horizon: float, off: float
) -> None:
    pair = Pair(seed, t)
    way = np.random.default_rng(seed).normal(size=3)
    way /= np.linalg.norm(way)
    share, further = (pair.share(horizon, gap * way) for gap in (off, off + 1e-4))
    assert abs(share - further) <= 2.0 * 1e-4 / 0.6 + 1e-9
    assert pair.share(horizon) - 1e-12 <= share <= 1.0


@given(seed=seeds, t=times, horizon=horizons)
def test_one_that_flies_to_no_slot_has_no_told_path(seed: int, t: float, horizon: float) -> None:
    pair = Pair(seed, t)
    off = 20.0 * np.ones(3)
    assert pair.share(horizon, off) == 1.0


@given(seed=seeds, t=times, horizon=horizons)
def test_one_that_left_its_own_path_has_none_either(seed: int, t: float, horizon: float) -> None:
    pair = Pair(seed, t)
    pair.velocities[0] += np.array([0.0, 0.0, 1.01 * REACH / pair.goal_moves])
    assert pair.share(horizon) == 1.0


@given(seed=seeds, t=times)
def test_where_paths_speed_up_the_present_velocity_counts(seed: int, t: float) -> None:
    pair = Pair(seed, t)
    assume(h_rate((t + 0.05) / PLAN_S, PLAN_S) > h_rate(t / PLAN_S, PLAN_S))
    assert pair.share(0.05) == 1.0


@pytest.mark.parametrize("t", [0.0, PLAN_S, PLAN_S + 1.0])
def test_before_and_after_the_plan_nothing_is_told(t: float) -> None:
    told = ToldPaths(t, PLAN_S, np.zeros(3), np.zeros(3), OWN, SLOTS, REACH, 0.0)
    still = path_share(told, OWN, np.zeros(3), SLOTS[1, :3], np.zeros(3), 1.0)
    without = path_share(told._replace(duration_s=0.0), OWN, OWN, OWN, OWN, 1.0)
    assert tuple(still) == tuple(without) == (1.0, 0.0, 1.0)
