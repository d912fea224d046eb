"""Places of a shape that moves: by hand, and every derivative by finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.curves.shape import PlaceMotion, place_samples, places, places_from_rest
from ptnsbc_core.types import HEADING_FIXED, HEADING_PATH, TRAJECTORY_HARMONIC, Shape, Trajectory

places, places_from_rest = on_arrays(places), on_arrays(places_from_rest)

STEP = 1e-5


def leader(heading: int) -> Trajectory:
    table = np.array([[1.0, 8.0, 0.1, 0.2], [2.0, 4.0, 0.2, 0.0], [8.0, 0.5, 0.1, 1.0]])
    return Trajectory((float(TRAJECTORY_HARMONIC), float(heading), *5 * (0.0,), 0.4), table)


def shape(turns: bool, rows: int = 2) -> Shape:
    """Polynomials of degree 7 at random, from 0 and from 6 s on."""
    table = np.random.default_rng(2).uniform(-1e-4, 1e-4, (rows, 57))
    table[:, 8::8] = np.random.default_rng(3).uniform(-2.0, 2.0, (rows, 7))
    table[:, 0] = 6.0 * np.arange(rows)
    return Shape(True, turns, table)


def constant(own: list[float], turn: float, turns: bool) -> Shape:
    table = np.zeros((1, 57))
    table[0, [8, 16, 24]], table[0, 56] = own, turn
    return Shape(True, turns, table)


def slopes(at: list[PlaceMotion]) -> None:
    """The middle one of three motions is the slope of the other two."""
    behind, now, ahead = at
    for k in (0, 1):
        slope = (ahead[k] - behind[k]) / (2 * STEP)
        scale = 1.0 + np.abs(now[k + 1]).max() + np.abs(now[k]).max()
        np.testing.assert_allclose(slope, now[k + 1], atol=1e-8 * scale)


@pytest.mark.parametrize("turns", [False, True])
@given(t=st.floats(0.1, 11.0))
def test_every_derivative_is_the_slope_of_the_one_before(turns: bool, t: float) -> None:
    if abs(t - 6.0) < 2 * STEP:
        return
    at = [places(shape(turns), leader(HEADING_PATH), t + k * STEP) for k in (-1, 0, 1)]
    slopes([one.own for one in at])
    slopes([one.parent for one in at])


@given(t=st.floats(0.1, 7.0))
def test_derivatives_from_rest_are_slopes_too(t: float) -> None:
    if abs(t - 4.6) < 2 * STEP:
        return
    moving, path = shape(True, 1), leader(HEADING_PATH)
    at = [places_from_rest(moving, path, 4.6, t + k * STEP) for k in (-1, 0, 1)]
    slopes([one.own for one in at])
    slopes([one.parent for one in at])


def test_begins_at_rest_and_ends_with_the_shape() -> None:
    moving, path = shape(True), leader(HEADING_PATH)
    first = places_from_rest(moving, path, 4.6, 0.0).own
    np.testing.assert_array_equal(first.position, places(moving, path, 0.0).own.position)
    np.testing.assert_array_equal(first.velocity, np.zeros(3))
    np.testing.assert_array_equal(first.acceleration, np.zeros(3))
    for field, known in zip(
        places_from_rest(moving, path, 4.6, 4.6).own, places(moving, path, 4.6).own, strict=True
    ):
        np.testing.assert_array_equal(field, known)
    before = places_from_rest(moving, path, 4.6, 4.6 - 1e-9).own
    for k in range(3):
        np.testing.assert_allclose(before[k], places(moving, path, 4.6).own[k], atol=1e-7)


def test_a_place_behind_the_leader_stays_behind_it() -> None:
    """Two metres behind, on a path that turns: opposite to the velocity."""
    path = leader(HEADING_PATH)
    behind = constant([-2.0, 0.0, 0.0], 0.0, True)
    for t in (0.0, 9.0, 30.0):
        ahead = np.array([0.8 * np.cos(0.1 * t + 0.2), 0.8 * np.cos(0.2 * t)])
        known = -2.0 * ahead / np.linalg.norm(ahead)
        np.testing.assert_allclose(places(behind, path, t).own.position[:2], known, atol=1e-12)


def test_a_quarter_of_a_turn_by_hand() -> None:
    at = places(constant([1.0, 2.0, 3.0], np.pi / 2, False), leader(HEADING_FIXED), 5.0).own
    np.testing.assert_allclose(at.position, [-2.0, 1.0, 3.0], atol=1e-12)
    np.testing.assert_array_equal(at.velocity, np.zeros(3))


def test_samples_are_the_places() -> None:
    moving, path = shape(True), leader(HEADING_PATH)
    times = np.array([0.5, 7.0])
    found = place_samples(moving, path, times)
    for row, t in zip(found, times, strict=True):
        own = places(moving, path, t).own
        np.testing.assert_array_equal(row, np.concatenate(own))
