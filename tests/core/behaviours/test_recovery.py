"""The way back after an encounter: bumpless, over after T whatever it starts from, and armed anew by the next one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptnsbc_core.behaviours.recovery import (
    DISTURBED,
    UNDISTURBED,
    armed,
    recovery_duration,
    way_back,
)
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import RecoveryConfig

KAPPA, DT = 2.2, 0.01
CONFIG = RecoveryConfig(1.0, 6.0, 2.5)

metres = st.floats(-5.0, 5.0)
speeds = st.floats(-3.0, 3.0)
vectors = st.tuples(metres, metres, metres)
velocities = st.tuples(speeds, speeds, speeds)


def at(recovery, s: float, dt: float = DT):
    return way_back(recovery, Clock(recovery.t + s, 0.0, dt), KAPPA)


@given(vectors, velocities)
@settings(max_examples=200, deadline=None)
def test_it_begins_with_the_deviation_and_the_velocity_of_the_uav(x, u) -> None:
    recovery = armed(x, u, 7.0, KAPPA, CONFIG)
    first = at(recovery, 0.0, 1e-5)
    np.testing.assert_allclose(first.deviation, x, atol=1e-9)
    np.testing.assert_allclose(first.velocity, u, atol=1e-3)
    assert first.progress == 0.0


@given(vectors, velocities)
@settings(max_examples=200, deadline=None)
def test_nothing_is_left_of_it_after_its_duration(x, u) -> None:
    """Predefined: T is known when it is armed, and P and P_dot vanish there."""
    recovery = armed(x, u, 7.0, KAPPA, CONFIG)
    end = at(recovery, recovery.duration_s)
    assert end == at(UNDISTURBED, 0.0)
    before = at(recovery, recovery.duration_s - DT)
    scale = np.linalg.norm(x) + np.linalg.norm(u)
    assert np.linalg.norm(before.deviation) <= 1e-4 * scale
    assert np.linalg.norm(before.velocity) <= 2e-2 * scale


@given(vectors)
@settings(max_examples=100, deadline=None)
def test_from_rest_it_asks_for_no_more_than_its_limits(x) -> None:
    recovery = armed(x, (0.0, 0.0, 0.0), 0.0, KAPPA, CONFIG)
    ticks = [at(recovery, s) for s in np.arange(0.0, recovery.duration_s, DT)]
    assert max(np.linalg.norm(one.velocity) for one in ticks) <= CONFIG.speed * 1.001
    assert max(np.linalg.norm(one.acceleration) for one in ticks) <= CONFIG.acceleration * 1.001


def test_who_comes_back_by_the_feedback_already_goes_on_so() -> None:
    """u = kappa x is the velocity of the feedback: A is 0, and P never is above x e^(-kappa s)."""
    x = np.array([1.0, -2.0, 0.5])
    recovery = armed(tuple(x), tuple(KAPPA * x), 0.0, KAPPA, CONFIG)
    np.testing.assert_allclose(recovery.rest, 0.0, atol=1e-12)
    for s in (0.3, 0.9, 1.8):
        left = np.linalg.norm(at(recovery, s).deviation)
        assert left <= np.linalg.norm(x) * np.exp(-KAPPA * s)


def test_duration_is_a_closed_form_of_the_distance() -> None:
    """sqrt(7.513 d / a) for short ways, 2.1875 d / v for long ones, and never less than the least."""
    assert recovery_duration(0.0, CONFIG) == 1.0
    assert recovery_duration(2.0, CONFIG) == pytest.approx(np.sqrt(7.513 * 2.0 / 2.5))
    assert recovery_duration(40.0, CONFIG) == pytest.approx(2.1875 * 40.0 / 6.0)


@pytest.mark.parametrize("recovery", [UNDISTURBED, DISTURBED])
def test_without_a_way_back_nothing_is_added(recovery) -> None:
    zero = (0.0, 0.0, 0.0)
    assert tuple(way_back(recovery, Clock(3.0, 3.0, DT), KAPPA)) == (zero, zero, zero, 1.0)
