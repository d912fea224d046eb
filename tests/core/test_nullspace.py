"""Null-space composition: strict priority, bounded rank loss, and why (11)'s projection is not enough."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from on_arrays import on_arrays

from ptnsbc_core.nullspace import (
    compose,
    compose_with_clearance,
    damped_solve,
    limit_by_priority,
    null_space_projector,
)
from ptnsbc_core.tasks.near_constraints import empty_memory
from ptnsbc_core.types import ClearanceTask

compose_with_clearance = on_arrays(compose_with_clearance)
damped_solve = on_arrays(damped_solve)
limit_by_priority = on_arrays(limit_by_priority)

NEVER = 1e-9  # a threshold below every singular value here: no damping
NOTHING = np.zeros(3)

vectors = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
seeds = st.integers(0, 2**31)


def rows_of(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


@given(seed=seeds, count=st.integers(1, 4))
def test_projector_is_a_symmetric_idempotent_null_space(seed: int, count: int) -> None:
    jacobian = rows_of(seed, count)
    n = null_space_projector(jacobian)
    np.testing.assert_allclose(n, n.T, atol=1e-15)
    np.testing.assert_allclose(n @ n, n, atol=1e-13)
    np.testing.assert_allclose(jacobian @ n, np.zeros((count, 3)), atol=1e-6)
    assert np.trace(n) == pytest.approx(max(3 - count, 0), abs=1e-9)
    if np.linalg.svd(jacobian, compute_uv=False)[min(count, 3) - 1] > 1e-3:
        expected = np.eye(3) - np.linalg.pinv(jacobian) @ jacobian
        np.testing.assert_allclose(n, expected, atol=1e-9)


def test_projector_of_dependent_rows_frees_what_none_of_them_holds() -> None:
    same = np.array([[1.0, 0, 0], [1.0, 0, 0]])
    np.testing.assert_allclose(null_space_projector(same), np.diag([0.0, 1, 1]), atol=1e-15)
    np.testing.assert_array_equal(null_space_projector(np.empty((0, 3))), np.eye(3))


@given(seed=seeds)
def test_lower_priority_leaves_all_higher_velocities_unchanged(seed: int) -> None:
    """Three levels of one row each: every prefix of the sum moves its own tasks as it did alone."""
    rng = np.random.default_rng(seed)
    jacobians, velocities = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    parts = compose(velocities, jacobians, np.ones(3))
    total = parts.sum(axis=0)
    first = parts[0]
    second = parts[0] + parts[1]
    assert jacobians[0] @ total == pytest.approx(jacobians[0] @ first, abs=1e-5)
    assert jacobians[1] @ total == pytest.approx(jacobians[1] @ second, abs=1e-5)
    np.testing.assert_array_equal(first, velocities[0])


def test_projection_on_one_level_as_in_11_disturbs_the_first_task() -> None:
    """With J1 = x and J2 = x + y, the null space of J2 alone still holds x: level 3 moves task 1."""
    jacobians = np.array([[1.0, 0, 0], [1.0, 1.0, 0], [0, 0, 1.0]])
    velocities = np.array([[1.0, 0, 0], [0, 1.0, 0], [1.0, 0.0, 1.0]])
    n2 = np.eye(3) - np.linalg.pinv(jacobians[1:2]) @ jacobians[1:2]
    printed = (
        velocities[0] + null_space_projector(jacobians[:1]) @ velocities[1] + n2 @ velocities[2]
    )
    assert jacobians[0] @ printed - jacobians[0] @ velocities[0] == pytest.approx(0.5)
    total = compose(velocities, jacobians, np.ones(3)).sum(axis=0)
    np.testing.assert_allclose(total, [1.0, 1.0, 1.0], atol=1e-14)


def test_order_matters() -> None:
    jacobians = np.array([[1.0, 0, 0], [1.0, 1.0, 0]])
    velocities = np.array([[1.0, 0, 0], [-1.0, -1.0, 0]])
    one = compose(velocities, jacobians, np.ones(2)).sum(axis=0)
    other = compose(velocities[::-1].copy(), jacobians[::-1].copy(), np.ones(2)).sum(axis=0)
    np.testing.assert_allclose(one, [1.0, -1.0, 0])
    np.testing.assert_allclose(other, [-0.5, -1.5, 0])


def test_a_task_without_rows_takes_nothing_away() -> None:
    velocities = np.array([[0.0, 0, 0], [1.0, 2, 3]])
    parts = compose(velocities, np.eye(3), np.array([0.0, 3.0]))
    np.testing.assert_array_equal(parts.sum(axis=0), [1, 2, 3])


@given(seed=seeds, rate=vectors)
def test_solution_is_that_of_numpys_pseudo_inverse(seed: int, rate: np.ndarray) -> None:
    jacobian = rows_of(seed, 3)
    least = np.linalg.svd(jacobian, compute_uv=False)[-1]
    found = damped_solve(jacobian, rate, NOTHING, NEVER, 0.0)
    assert found.singular_value == pytest.approx(least, abs=1e-6)
    if least > 0.05:
        expected = np.linalg.pinv(jacobian) @ rate
        np.testing.assert_allclose(found.velocity, expected, atol=1e-9)


@given(seed=seeds, rate=vectors, fallback=vectors, threshold=st.floats(0.01, 2.0))
def test_solution_is_the_svd_of_the_design(
    seed: int, rate: np.ndarray, fallback: np.ndarray, threshold: float
) -> None:
    """Every singular direction by itself: s / (s^2 + lambda^2), and the rest of it for the fallback."""
    jacobian = rows_of(seed, 3)
    damping = 0.5
    u, singular, vt = np.linalg.svd(jacobian)
    expected = np.zeros(3)
    for k, s in enumerate(singular):
        lam2 = damping**2 * (1.0 - (s / threshold) ** 2) if s < threshold else 0.0
        share = s * s / (s * s + lam2)
        expected += vt[k] * (s / (s * s + lam2) * (u[:, k] @ rate))
        expected += vt[k] * ((1.0 - share) * (vt[k] @ fallback))
    found = damped_solve(jacobian, rate, fallback, threshold, damping).velocity
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_rank_loss_is_bounded() -> None:
    """One singular value through zero: at most rate / (2 damping), where the plain inverse has no bound."""
    rate = np.array([1.0, 1.0, 1.0])
    largest = 0.0
    for s in np.linspace(0.0, 1.0, 2001):
        jacobian = np.diag([1.0, 1.0, s])
        out = damped_solve(jacobian, rate, NOTHING, 0.35, 0.5).velocity
        np.testing.assert_allclose(out[:2], [1.0, 1.0])  # the other directions do not feel it
        largest = max(largest, abs(out[2]))
    assert 1.0 / 0.5 < largest < 3.0
    np.testing.assert_allclose(
        damped_solve(np.diag([1.0, 1.0, 0.0]), rate, NOTHING, 0.35, 0.5).velocity,
        [1.0, 1.0, 0.0],
    )


def test_damping_fades_in_without_a_step() -> None:
    rate, fallback = np.array([1.0, 1.0, 1.0]), np.array([0.0, 0.0, -4.0])
    values = np.linspace(0.0, 0.5, 5001)
    z = [
        damped_solve(np.diag([1.0, 1.0, s]), rate, fallback, 0.35, 0.5).velocity[2] for s in values
    ]
    assert np.abs(np.diff(z)).max() < 0.02


def test_fallback_has_no_say_away_from_a_singularity() -> None:
    jacobian = np.array([[1.0, 0.2, 0], [0, 0.8, 0.1], [0.1, 0, 1.2]])
    rate, fallback = np.array([0.3, -1.0, 0.2]), np.array([9.0, 9.0, 9.0])
    with_it = damped_solve(jacobian, rate, fallback, 0.35, 0.5).velocity
    without = damped_solve(jacobian, rate, NOTHING, 0.35, 0.5).velocity
    np.testing.assert_allclose(with_it, without)
    np.testing.assert_allclose(jacobian @ with_it, rate, atol=1e-12)


def test_fallback_fills_what_the_task_cannot_steer() -> None:
    jacobian = np.diag([1.0, 1.0, 0.0])
    out = damped_solve(jacobian, np.ones(3), np.array([5.0, 6.0, 7.0]), 0.35, 0.5)
    np.testing.assert_allclose(out.velocity, [1.0, 1.0, 7.0])
    assert out.singular_value == 0.0


parts3 = arrays(np.float64, (3, 3), elements=st.floats(-3.0, 3.0))


@given(parts=parts3, limit=st.floats(0.5, 6.0))
def test_the_lowest_priority_gives_way_first(parts: np.ndarray, limit: float) -> None:
    parts[0] *= min(1.0, 0.9 * limit / max(np.linalg.norm(parts[0]), 1e-9))
    out = limit_by_priority(parts, limit)
    assert np.linalg.norm(out) <= limit * (1.0 + 1e-9)
    total = parts[0].copy()
    for level in (1, 2):
        if np.linalg.norm(total + parts[level]) <= limit:
            total = total + parts[level]
            continue
        # the first level that does not fit is cut at the limit, those below it are dropped
        assert np.linalg.norm(out) == pytest.approx(limit, rel=1e-6)
        assert np.linalg.norm(np.cross(out - total, parts[level])) < 1e-6
        return
    np.testing.assert_allclose(out, total, atol=1e-12)


def test_scaling_by_hand() -> None:
    parts = np.array([[3.0, 0, 0], [0, 8.0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(limit_by_priority(parts, 5.0), [3.0, 4.0, 0.0])


def test_speed_limit_takes_from_the_formation_first() -> None:
    top = ClearanceTask(
        np.array([3.0, 0, 0]), np.array([[1.0, 0, 0]]), np.array([-9.0, 8, 0]), empty_memory()
    )
    out = compose_with_clearance(top, 5.0)
    np.testing.assert_allclose(out.velocity, [3.0, 4.0, 0.0], atol=1e-12)
    assert out.limited
    assert out.violation == pytest.approx(0.0, abs=1e-12)
    free = compose_with_clearance(top, 50.0)
    np.testing.assert_allclose(free.velocity, [3.0, 8.0, 0.0])
    assert not free.limited
