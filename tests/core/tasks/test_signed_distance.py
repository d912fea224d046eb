"""Signed distances: closed forms, finite differences, gradients of length 1, and the sphere that stands for a body."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ptnsbc_core.tasks.signed_distance import (
    AXES,
    BODIES,
    BODY_COLUMNS,
    KEEP_OUT,
    KIND,
    SIZE,
    TANGENT_RADIUS_M,
    flattened,
    signed_distance,
    signed_distances,
    slope,
    tangent_centre,
)

SIZES = {
    "sphere": (0.0, 0.0, 0.0),
    "box": (1.0, 0.5, 2.0),
    "cylinder": (0.7, 1.5, 0.0),
    "half_space": (0.0, 0.0, 0.0),
    "plane": (0.0, 0.0, 0.0),
}
KINDS = tuple(SIZES)
number = st.floats(-4.0, 4.0)
places = st.tuples(number, number, number)
turns = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def body(kind, position=(0, 0, 0), turn=(0, 0, 0), size=None) -> np.ndarray:
    row = np.zeros(BODY_COLUMNS)
    row[0:3], row[KIND], row[KEEP_OUT] = position, BODIES[kind], 0.4
    row[SIZE : SIZE + 3] = SIZES[kind] if size is None else size
    row[AXES : AXES + 9] = Rotation.from_euler("xyz", turn).as_matrix().ravel()
    return row


def at(place, row) -> float:
    return signed_distance(tuple(map(float, place)), row).distance


@pytest.mark.parametrize(
    ("kind", "place", "distance", "gradient"),
    [
        ("sphere", (3, 0, 4), 5.0, (0.6, 0, 0.8)),
        ("box", (4, 0.2, 1), 3.0, (1, 0, 0)),
        ("box", (4, -4.5, 0), 5.0, (0.6, -0.8, 0)),
        ("box", (2, 1.5, 3), np.sqrt(3), np.ones(3) / np.sqrt(3)),
        ("box", (0.9, 0, 0), -0.1, (1, 0, 0)),
        ("cylinder", (0, -2.7, 1), 2.0, (0, -1, 0)),
        ("cylinder", (0.1, 0.1, -2), 0.5, (0, 0, -1)),
        ("cylinder", (0, 3.7, 5.5), 5.0, (0, 0.6, 0.8)),
        ("cylinder", (0.5, 0, 0), -0.2, (1, 0, 0)),
        ("cylinder", (0, 0, 1.4), -0.1, (0, 0, 1)),
        ("half_space", (7, 8, 2), 2.0, (0, 0, 1)),
        ("half_space", (7, 8, -2), -2.0, (0, 0, 1)),
        ("plane", (7, 8, -2), 2.0, (0, 0, -1)),
    ],
)
def test_closed_forms(kind, place, distance, gradient) -> None:
    found = signed_distance(tuple(map(float, place)), body(kind))
    assert found.distance == pytest.approx(distance)
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-12)


def test_a_cylinder_without_end_has_no_ends() -> None:
    endless = body("cylinder", size=(0.7, np.inf, 0))
    found = signed_distance((0.0, 1.7, 1e5), endless)
    assert found.distance == pytest.approx(1.0)
    np.testing.assert_allclose(found.gradient, (0, 1, 0))
    assert at((0.0, 0.0, 5.0), endless) == pytest.approx(-0.7)


def test_a_turned_body_is_turned() -> None:
    quarter = body("box", position=(1, 2, 3), turn=(0, 0, np.pi / 2))
    found = signed_distance((1.0, 5.0, 3.0), quarter)  # its long edge along x is along y now
    assert found.distance == pytest.approx(2.0)
    np.testing.assert_allclose(found.gradient, (0, 1, 0), atol=1e-12)
    wall = body("half_space", turn=(0, np.pi / 2, 0))  # its normal z is along x now
    assert at((3.0, 1.0, 1.0), wall) == pytest.approx(3.0)


@pytest.mark.parametrize("kind", KINDS)
@given(place=places, position=places, turn=turns)
def test_the_gradient_is_that_of_finite_differences(kind, place, position, turn) -> None:
    row, step = body(kind, position, turn), 1e-6
    found = signed_distance(place, row)
    assert np.linalg.norm(found.gradient) == pytest.approx(1.0)
    slopes = []
    for axis in np.eye(3):
        ahead = at(place + step * axis, row) - found.distance
        behind = found.distance - at(place - step * axis, row)
        assume(abs(ahead - behind) < 1e-9)  # not on an edge inside, where the nearest face changes
        slopes.append(0.5 * (ahead + behind) / step)
    np.testing.assert_allclose(found.gradient, slopes, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@given(one=places, other=places, turn=turns)
def test_nearer_by_no_more_than_the_way(kind, one, other, turn) -> None:
    row = body(kind, turn=turn)
    way = np.linalg.norm(np.subtract(one, other))
    assert abs(at(one, row) - at(other, row)) <= way + 1e-9


@pytest.mark.parametrize("kind", ["box", "cylinder"])
@given(place=places)
def test_outside_it_is_the_distance_to_the_nearest_point(kind, place) -> None:
    row = body(kind)
    assume(at(place, row) > 0.05)
    limits = [(-one, one) for one in SIZES["box"]]
    rules = ()
    if kind == "cylinder":
        radius, half, _ = SIZES[kind]
        limits = [(-radius, radius), (-radius, radius), (-half, half)]
        rules = ({"type": "ineq", "fun": lambda x: radius**2 - x[0] ** 2 - x[1] ** 2},)
    nearest = minimize(
        lambda x: np.sum((x - place) ** 2),
        np.zeros(3),
        bounds=limits,
        constraints=rules,
        method="SLSQP",
    )
    assert at(place, row) == pytest.approx(np.sqrt(nearest.fun), abs=1e-3)


@pytest.mark.parametrize("kind", KINDS[1:])
@given(place=places, turn=turns)
def test_the_sphere_for_a_body_touches_it_and_has_its_distance(kind, place, turn) -> None:
    row = body(kind, turn=turn)
    found = signed_distance(place, row)
    centre = np.array(tangent_centre(place, found))
    assert np.linalg.norm(place - centre) - TANGENT_RADIUS_M == pytest.approx(found.distance)
    surface = place - found.distance * np.array(found.gradient)
    assert at(surface, row) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS[1:])
@given(place=places, spread=places)
def test_a_convex_body_lies_behind_the_plane_that_touches_it(kind, place, spread) -> None:
    """Who keeps clear of that plane keeps clear of the body."""
    row = body(kind)
    found, other = signed_distance(place, row), signed_distance(spread, row)
    assume(found.distance > 0.0)
    of_body = spread - max(other.distance, 0.0) * np.array(other.gradient)
    assert np.dot(found.gradient, place - of_body) >= found.distance - 1e-9


def test_many_places_at_once() -> None:
    row = body("box")
    some = np.array([[4.0, 0.2, 1.0], [2.0, 1.5, 3.0]])
    np.testing.assert_array_equal(signed_distances(some, row), [at(one, row) for one in some])


@given(place=places, flat=st.floats(0.1, 1.0))
def test_the_slope_of_a_distance_whose_heights_count_less_is_its_gradient(place, flat) -> None:
    def distance(where) -> float:
        return float(np.linalg.norm(flattened(where, flat)))

    assume(distance(place) > 0.05)
    normal, rate = slope(np.divide(flattened(place, flat), distance(place)), flat)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert flat - 1e-9 <= rate <= 1.0
    steps = 1e-6 * np.eye(3)
    gradient = [(distance(place + one) - distance(place - one)) / 2e-6 for one in steps]
    np.testing.assert_allclose(rate * np.array(normal), gradient, atol=1e-6)


@given(place=places)
def test_where_heights_count_in_full_no_bit_changes(place) -> None:
    assert flattened(place, 1.0) == place
    assert slope(place, 1.0) == (place, 1.0)
