"""Reaching functions: the time to zero in closed form, before T from anywhere, and the slope by differences."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from paper.baselines.reaching import EXPONENTIAL, FLOOR, TWO_SIDED, Reaching, phi, slope

LAWS = [Reaching(EXPONENTIAL, 2.5, 0.3), Reaching(TWO_SIDED, 2.5, 0.4)]
both = pytest.mark.parametrize("law", LAWS, ids=("exponential", "two_sided"))


def reached_s(law: Reaching, start: float) -> float:
    """Closed form of the time at which x_dot = -phi(x) is zero."""
    if law.kind == EXPONENTIAL:
        return law.duration_s * (1.0 - math.exp(-(start**law.power)))
    return law.duration_s * 2.0 / math.pi * math.atan(start**law.power)


@both
@pytest.mark.parametrize("start", [0.1, 1.0, 8.06, 1000.0])
def test_zero_is_reached_when_the_closed_form_says_and_before_t(
    law: Reaching, start: float
) -> None:
    def nearly(t, x):
        return x[0] - 1e-6

    nearly.terminal = True
    out = solve_ivp(
        lambda t, x: [-phi(float(x[0]), law)],
        (0, 10),
        [start],
        events=nearly,
        rtol=1e-9,
        atol=1e-12,
    )
    left = reached_s(law, 1e-6)
    assert out.t_events[0][0] + left == pytest.approx(reached_s(law, start), rel=1e-4)
    assert out.t_events[0][0] < law.duration_s


@both
@pytest.mark.parametrize("x", [0.01, 0.5, 3.0, 40.0, -0.5, -8.0])
def test_slope_by_differences(law: Reaching, x: float) -> None:
    step = 1e-6 * abs(x)
    rise = (phi(x + step, law) - phi(x - step, law)) / (2 * step)
    assert slope(x, law) == pytest.approx(rise, rel=1e-6)


@both
def test_odd_zero_at_zero_and_a_floored_slope(law: Reaching) -> None:
    assert phi(0.0, law) == 0.0
    assert phi(-2.0, law) == -phi(2.0, law)
    assert slope(0.0, law) == slope(FLOOR, law) == slope(-FLOOR / 2, law) < np.inf


def test_one_value_by_hand() -> None:
    assert phi(1.0, LAWS[0]) == pytest.approx(math.e / 0.75)
    assert phi(1.0, LAWS[1]) == pytest.approx(math.pi)
