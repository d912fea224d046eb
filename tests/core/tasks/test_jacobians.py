"""Every registered task: all three Jacobians against finite differences, and invariance under shifts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.tasks.formation_tasks import evaluate, task_error
from ptnsbc_core.tasks.table import TASKS

evaluate = on_arrays(evaluate)
task_error = on_arrays(task_error)

every_task = pytest.mark.parametrize("task", TASKS.values(), ids=TASKS.keys())
FIELDS = ("own", "parent", "reference")
seeds = st.integers(0, 2**31)


def spread(seed: int) -> tuple[np.ndarray, ...]:
    """Own, parent and reference position, at least 1.2 m apart in every projection."""
    rng = np.random.default_rng(seed)
    while True:
        points = rng.uniform(-6.0, 6.0, (3, 3))
        gaps = [points[a] - points[b] for a, b in ((0, 1), (0, 2), (1, 2))]
        if all(min(np.hypot(g[0], g[1]), np.hypot(g[0], g[2])) > 1.2 for g in gaps):
            return tuple(points)


@every_task
@given(seed=seeds)
def test_jacobians_by_finite_differences(task: int, seed: int) -> None:
    points = spread(seed)
    geometry = evaluate(task, *points)
    step = 1e-5
    for which, field in enumerate(FIELDS):
        analytic = getattr(geometry, field)
        for axis in range(3):
            ends = []
            for sign in (1.0, -1.0):
                moved = [point.copy() for point in points]
                moved[which][axis] += sign * step
                ends.append(evaluate(task, *moved))
            # task_error knows which rows are angles: no step where one passes pi
            slope = task_error(ends[1], ends[0].value) / (2.0 * step)
            np.testing.assert_allclose(analytic[:, axis], slope, atol=1e-7)


@every_task
@given(seed=seeds)
def test_shifting_all_three_together_changes_nothing(task: int, seed: int) -> None:
    points = spread(seed)
    geometry = evaluate(task, *points)
    whole = geometry.own + geometry.parent + geometry.reference
    np.testing.assert_allclose(whole, np.zeros((3, 3)), atol=1e-12)
    shift = np.array([3.0, -2.0, 5.0])
    moved = evaluate(task, *(point + shift for point in points))
    np.testing.assert_allclose(task_error(moved, geometry.value), np.zeros(3), atol=1e-9)


@every_task
def test_geometry_stays_finite_where_points_coincide(task: int) -> None:
    """Table 2: UAV 2 and 3 share x and z, so a projected vector of (23) has no length."""
    own, parent, leader = np.array([-1.0, 0, 1]), np.array([-1.0, -1, 1]), np.array([0.0, 1, 1])
    for points in ((own, parent, leader), (own, own, leader), (own, parent, own), (own, own, own)):
        geometry = evaluate(task, *(point.copy() for point in points))
        for part in geometry:
            assert np.all(np.isfinite(part))
        # softened: an angle never turns faster than 10 rad/m per vector
        assert np.abs(geometry.own).max() <= 20.0
