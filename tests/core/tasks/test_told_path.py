"""Told paths: on the plan the closed form, off it the present velocity, and continuous in between."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.curves.turned import Factor, left_at, scaled
from ptnsbc_core.tasks.told_path import ToldPaths, path_share
from ptnsbc_core.timebase import h, h_rate

path_share = on_arrays(path_share)

TF = 5.0
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
        self.told = ToldPaths(t, TF, self.leader, self.leader_velocity, OWN, SLOTS, REACH, turn)
        left, rate = 1.0 - h(t / TF), h_rate(t / TF, TF)
        dt = 1e-6
        self.positions = self.leader + self.places(t)
        self.velocities = self.leader_velocity + (self.places(t + dt) - self.places(t - dt)) / (
            2.0 * dt
        )
        self.goal_moves = left / rate  # by so much for 1 m/s

    def places(self, t: float) -> np.ndarray:
        """Planned positions (2, 3) beside the leader."""
        z = left_at(self.told.turn, t / TF)
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
    assume(h_rate((t + 0.05) / TF, TF) > h_rate(t / TF, TF))
    assert pair.share(0.05) == 1.0


@pytest.mark.parametrize("t", [0.0, TF, TF + 1.0])
def test_before_and_after_the_plan_nothing_is_told(t: float) -> None:
    told = ToldPaths(t, TF, np.zeros(3), np.zeros(3), OWN, SLOTS, REACH, 0.0)
    still = path_share(told, OWN, np.zeros(3), SLOTS[1, :3], np.zeros(3), 1.0)
    without = path_share(told._replace(duration_s=0.0), OWN, OWN, OWN, OWN, 1.0)
    assert tuple(still) == tuple(without) == (1.0, 0.0, 1.0)
