"""The leader's desired curve: the paper's circle by hand, and every derivative by finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays
from scipy.interpolate import PPoly

from ptnsbc_core.curves.trajectory import curve_state, polynomial, reference, row_at
from ptnsbc_core.types import (
    HEADING_FIXED,
    HEADING_PATH,
    HEADING_TABLE,
    TRAJECTORY_CIRCLE,
    TRAJECTORY_HARMONIC,
    TRAJECTORY_LINE,
    TRAJECTORY_PIECEWISE,
    Trajectory,
)
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory

reference, curve_state = on_arrays(reference), on_arrays(curve_state)

NO_TABLE = np.zeros((0, 33))
LINE = Trajectory((float(TRAJECTORY_LINE), 1.0, 2.0, 3.0, 0.5, -0.25, 0.1, 0.7), NO_TABLE)
CIRCLE = Trajectory((float(TRAJECTORY_CIRCLE), 1.0, 2.0, 3.0, 4.0, 0.3, 0.6, -0.2), NO_TABLE)


def harmonic(heading: int) -> Trajectory:
    table = np.array([[1.0, 4.0, 0.3, 0.2], [2.0, 3.0, 0.6, 0.0], [5.0, 0.5, 0.2, 1.0]])
    return Trajectory((float(TRAJECTORY_HARMONIC), float(heading), *5 * (0.0,), 0.4), table)


def piecewise(heading: int, period: float) -> Trajectory:
    """Three pieces of random polynomials from 0, 2 and 3 s; they do not meet."""
    table = np.random.default_rng(1).uniform(-0.1, 0.1, (3, 33))
    table[:, 0] = [0.0, 2.0, 3.0]
    return Trajectory(
        (float(TRAJECTORY_PIECEWISE), float(heading), period, *4 * (0.0,), 0.4), table
    )


CURVES = {
    "line": LINE,
    "circle": CIRCLE,
    "harmonic": harmonic(HEADING_FIXED),
    "harmonic along its path": harmonic(HEADING_PATH),
    "pieces": piecewise(HEADING_TABLE, 0.0),
    "pieces along their path": piecewise(HEADING_PATH, 3.5),
}


@pytest.mark.parametrize("t", [0.0, 7.0, 31.4])
def test_circle_of_the_paper(t: float) -> None:
    """X_r1 = [5 sin(0.1 t), 5 cos(0.1 t), 8, 0, 0, 0]."""
    at = reference(leader_trajectory(load_scenario("paper_5")), t)
    np.testing.assert_allclose(at.position, [5 * np.sin(0.1 * t), 5 * np.cos(0.1 * t), 8])
    assert at.yaw == 0.0


def test_line_by_hand() -> None:
    at = reference(LINE, 4.0)
    np.testing.assert_allclose(at.position, [3.0, 1.0, 3.4])
    assert at.yaw == 0.7


def test_harmonic_by_hand() -> None:
    at = reference(harmonic(HEADING_FIXED), 5.0)
    np.testing.assert_allclose(at.position[1], 2.0 + 3.0 * np.sin(3.0))
    np.testing.assert_allclose(at.velocity[1], 3.0 * 0.6 * np.cos(3.0))
    assert at.yaw == 0.4


@pytest.mark.parametrize("name", CURVES)
@given(t=st.floats(0.01, 5.0))
def test_every_derivative_is_the_slope_of_the_one_before(name: str, t: float) -> None:
    curve, step = CURVES[name], 1e-6
    seams = [0.0, 2.0, 3.0, 3.5] if "pieces" in name else []
    since = t % 3.5 if name == "pieces along their path" else t
    if any(abs(since - seam) < 2 * step for seam in seams):
        return
    now, ahead, behind = (
        curve_state(curve, t),
        curve_state(curve, t + step),
        curve_state(curve, t - step),
    )
    if np.hypot(*now.velocity[:2]) < 0.05 and "path" in name:
        return  # the heading of a path that stands still is none
    derivatives = [now.velocity, now.acceleration, now.jerk]
    pairs = zip((ahead[:3]), behind[:3], derivatives, strict=True)
    for later, earlier, slope in pairs:
        scale = 1.0 + np.abs(slope).max() + np.abs(now.position).max()
        np.testing.assert_allclose((later - earlier) / (2 * step), slope, atol=1e-7 * scale)
    turned = np.mod(ahead.heading.angle - behind.heading.angle + np.pi, 2 * np.pi) - np.pi
    scale = 1.0 + now.heading.rate**2 + abs(now.heading.acceleration) + abs(now.heading.angle)
    np.testing.assert_allclose(turned / (2 * step), now.heading.rate, atol=1e-7 * scale)
    slope = (ahead.heading.rate - behind.heading.rate) / (2 * step)
    np.testing.assert_allclose(slope, now.heading.acceleration, atol=1e-5 * scale**2)


@pytest.mark.parametrize("name", CURVES)
def test_reference_is_the_course_without_its_jerk(name: str) -> None:
    for t in (0.0, 1.3, 20.0):
        at, full = reference(CURVES[name], t), curve_state(CURVES[name], t)
        np.testing.assert_array_equal(at.position, full.position)
        np.testing.assert_array_equal(at.velocity, full.velocity)
        np.testing.assert_array_equal(at.acceleration, full.acceleration)
        assert at.yaw == full.heading.angle


def test_a_path_that_stands_still_keeps_its_yaw() -> None:
    rest = Trajectory((float(TRAJECTORY_PIECEWISE), 1.0, *5 * (0.0,), 0.4), np.zeros((1, 33)))
    assert curve_state(rest, 3.0).heading == (0.4, 0.0, 0.0)


def test_pieces_repeat_after_their_period() -> None:
    curve = piecewise(HEADING_TABLE, 3.5)
    for t in (0.2, 2.9, 3.4):
        np.testing.assert_allclose(
            reference(curve, t + 7.0).position, reference(curve, t).position, atol=1e-12
        )


STARTS = np.array([0.0, 1.5, 1.75, 4.0])


@pytest.mark.parametrize(
    ("t", "row"), [(-1.0, 0), (0.0, 0), (1.49, 0), (1.5, 1), (3.99, 2), (4.0, 3), (1e6, 3)]
)
def test_row_that_holds(t: float, row: int) -> None:
    assert row_at(STARTS.reshape(-1, 1), t) == row


def test_values_and_derivatives_are_scipys() -> None:
    coefficients = np.random.default_rng(0).normal(size=(2, 4, 8))
    table = np.concatenate([STARTS[:, None], *coefficients], axis=1)
    for channel in (0, 1):
        known = PPoly(coefficients[channel].T, np.array([*STARTS, 6.0]))
        for t in (0.3, 1.6, 2.9, 5.0):
            found = polynomial(table, row_at(table, t), channel, t)
            np.testing.assert_allclose(found, [known(t, order) for order in range(4)], rtol=1e-12)
