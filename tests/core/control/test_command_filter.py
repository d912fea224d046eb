"""Command filter: first order, limited, and a rate that is exactly what the value did."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from on_arrays import on_arrays

from ptnsbc_core.control.command_filter import filter_step

filter_step = on_arrays(filter_step)

vectors = arrays(np.float64, 3, elements=st.floats(-10.0, 10.0))


@given(state=vectors, target=vectors, bandwidth=st.floats(0.1, 500.0), limit=st.floats(0.1, 50.0))
def test_rate_is_limited_and_is_what_the_value_did(
    state: np.ndarray, target: np.ndarray, bandwidth: float, limit: float
) -> None:
    dt = 0.01
    out = filter_step(state, target, np.zeros(3), bandwidth, limit, dt)
    np.testing.assert_allclose(out.value, state + dt * out.rate, atol=1e-12)
    assert np.linalg.norm(out.rate) <= limit * (1.0 + 1e-9)
    # never past the target, whatever the bandwidth
    assert np.linalg.norm(target - out.value) <= np.linalg.norm(target - state) + 1e-9
    asked = min(bandwidth, 1.0 / dt) * (target - state)
    assert out.saturated == (np.linalg.norm(asked) > limit)
    np.testing.assert_allclose(np.cross(out.rate, target - state), np.zeros(3), atol=1e-6)


def test_step_response_is_first_order() -> None:
    state, target = np.zeros(3), np.array([1.0, -2.0, 0.5])
    for k in range(1, 101):
        state = filter_step(state, target, np.zeros(3), 4.0, 1e9, 0.01).value
        np.testing.assert_allclose(state, target * (1.0 - (1.0 - 0.04) ** k), atol=1e-12)


def test_a_switched_command_gives_no_impulse() -> None:
    """The command jumps by 6 m/s: the rate stays at the limit for the 0.6 s that the jump takes."""
    state, target = np.array([-3.0, 0, 0]), np.array([3.0, 0, 0])
    rates = []
    for _ in range(100):
        out = filter_step(state, target, np.zeros(3), 100.0, 10.0, 0.01)
        state = out.value
        rates.append(out.rate[0])
    assert max(rates) == pytest.approx(10.0)
    assert sum(rate > 9.999 for rate in rates) in (59, 60)
    np.testing.assert_allclose(state, target, atol=1e-9)


def test_a_target_with_a_known_rate_is_followed_without_lag() -> None:
    rate, dt = np.array([0.6, -0.4, 0.2]), 0.01
    state = target = np.array([1.0, 2.0, 3.0])
    for _ in range(200):
        state = filter_step(state, target, rate, 20.0, 5.0, dt).value
        target = target + dt * rate
    np.testing.assert_allclose(state, target, atol=1e-12)


def test_the_limit_holds_with_a_lead() -> None:
    out = filter_step(np.zeros(3), np.zeros(3), np.array([9.0, 0.0, 0.0]), 20.0, 5.0, 0.01)
    assert out.saturated
    np.testing.assert_allclose(out.rate, [5.0, 0.0, 0.0])
