"""Task `parent_angle` and `relative_position`: values by hand and the closed form of their conditioning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.tasks.formation_tasks import TASKS, ParentAngle, RelativePosition, conditioning

parent_angle = on_arrays(ParentAngle.evaluate)

ONES = np.ones(3)


def test_value_by_hand() -> None:
    """Parent at the origin looks at the leader in the north; the UAV is 5 m to the east, 12 m above."""
    geometry = parent_angle(np.array([5.0, 0, 12]), np.zeros(3), np.array([0.0, 3, 0]))
    np.testing.assert_allclose(geometry.value, [13.0, -np.pi / 2, 12.0])
    np.testing.assert_array_equal(geometry.periodic, [0, 1, 0])
    np.testing.assert_allclose(
        geometry.own, [[5 / 13, 0, 12 / 13], [0, 1 / 5, 0], [0, 0, 1]], atol=1e-15
    )


flat = st.tuples(st.floats(0.2, 6.0), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))


@given(place=flat)
def test_conditioning_of_a_flat_formation(place: tuple[float, float, float]) -> None:
    """sigma_min = min(1, 1/rho), wherever the UAV and the reference are seen from the parent."""
    rho, bearing, towards = place
    own = rho * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    reference = 3.0 * np.array([np.cos(towards), np.sin(towards), 0.0])
    found = conditioning(TASKS["parent_angle"], own, np.zeros(3), reference, ONES)
    assert found == pytest.approx(min(1.0, 1.0 / rho), rel=1e-6)
    scaled = conditioning(
        TASKS["parent_angle"], own, np.zeros(3), reference, np.array([1.0, rho, 1.0])
    )
    assert scaled == pytest.approx(1.0, rel=1e-6)


def test_where_distance_angles_vanishes_this_one_does_not() -> None:
    own, parent, leader = np.array([1.0, -1, 0]), np.array([-1.0, -1, 0]), np.zeros(3)
    assert conditioning(TASKS["distance_angles"], own, parent, leader, ONES) < 1e-7
    assert conditioning(TASKS["parent_angle"], own, parent, leader, ONES) == pytest.approx(0.5)


@given(seed=st.integers(0, 2**31))
def test_relative_position_is_never_singular(seed: int) -> None:
    own, parent, leader = np.random.default_rng(seed).normal(size=(3, 3))
    np.testing.assert_array_equal(
        RelativePosition.evaluate(own, parent, leader).value, own - parent
    )
    assert conditioning(TASKS["relative_position"], own, parent, leader, ONES) == 1.0
