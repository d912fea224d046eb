"""Data association: which near object is a neighbour, and that the own position error cancels."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.association import associate
from ptnsbc_core.behaviours.contract import Neighbour

associate = on_arrays(associate)

REPORTED = Neighbour(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 0.0]), np.zeros(3), 0.0)
NOTHING = np.empty((0, 7))


def row(x: float, y: float, z: float, *velocity: float) -> list[float]:
    return [x, y, z, 0.5, *(velocity or (0.0, 0.0, 0.0))]


def same(a: Neighbour, b: Neighbour) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize(
    ("near", "gate_m"),
    [(NOTHING, 0.2), (np.array([row(1.3, 2, 3)]), 0.2), (np.array([row(1.01, 2, 3)]), 0.0)],
)
def test_without_anything_close_enough_a_neighbour_is_where_it_says(near, gate_m) -> None:
    assert same(associate(REPORTED, near, 0.0, gate_m), REPORTED)


def test_the_nearest_one_is_taken_and_moved_on_by_its_age() -> None:
    near = np.array([row(1.15, 2, 3), row(0.95, 2, 3, 1.0, 2.0, 0.0), row(-4, 0, 0)])
    seen = associate(REPORTED, near, 0.02, 0.2)
    np.testing.assert_allclose(seen.position, (0.97, 2.04, 3.0), atol=1e-12)
    np.testing.assert_allclose(seen.velocity, (1.0, 2.0, 0.0))


def test_the_sensor_s_age_counts_in_the_choice() -> None:
    near = np.array([row(0.7, 2, 3, 3.0, 0.0, 0.0), row(1.15, 2, 3)])
    assert associate(REPORTED, near, 0.1, 0.2).position[0] == pytest.approx(1.0)
    assert associate(REPORTED, near, 0.0, 0.2).position[0] == pytest.approx(1.15)


def test_the_own_error_cancels_in_the_difference() -> None:
    """Seen from a believed place, a neighbour is as far away as it really is, whatever it says of itself."""
    own, other = np.zeros(3), np.array([1.2, -0.6, 0.1])
    own_error, its_error = np.array([0.02, -0.03, 0.01]), np.array([-0.04, 0.01, 0.02])
    near = np.array([row(*(other + own_error))])
    reported = Neighbour(other + its_error, np.zeros(3), np.zeros(3), 0.0)
    seen = associate(reported, near, 0.0, 0.2).position - (own + own_error)
    np.testing.assert_allclose(seen, other - own, atol=1e-12)
    assert np.linalg.norm((reported.position - (own + own_error)) - (other - own)) > 0.05
