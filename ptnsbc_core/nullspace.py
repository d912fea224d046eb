"""Null-space composition (7)-(11), (18)-(22), (37), (38) for any number of tasks, see docs/method.md.

    v = v_1 + N_1 v_2 + N_{1,2} v_3 + ...,  N = I - J^+ J of the stacked rows of all higher tasks

Every velocity is one UAV's in the world frame (3,) [m/s, ENU]. The controller applies Theta^-1, once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import (
    add3,
    axpy,
    dot3,
    eigen3,
    gram3,
    limit_norm,
    matvec,
    matvec_transposed,
    norm3,
    store3,
    sub3,
)
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Array, ClearanceTask, Matrix3, Vector3

RANK_TOLERANCE = 1e-9
"""Share of the largest eigenvalue of the Gram matrix below which a direction counts as free."""


class TaskVelocity(NamedTuple):
    """Velocity of a task, and how well the task determines it."""

    velocity: Vector3  # [m/s, ENU]
    singular_value: float  # smallest of the Jacobian


@kernel
def damped_solve(
    jacobian: Matrix3, rate: Vector3, fallback: Vector3, threshold: float, damping: float
) -> TaskVelocity:
    """J^+ rate + (I - J^+ J) fallback with the pseudo-inverse damped near a singularity.

    Each singular value s below `threshold` is damped by damping^2 (1 - (s/threshold)^2). What the damping
    takes away from the task is filled by `fallback`, a velocity of lower priority. Away from singularities
    J^+ J is the identity and the fallback has no effect. Singular values come from the Gram matrix, which for
    three unknowns gives the same decomposition without LAPACK.
    """
    gram = eigen3(gram3(jacobian))
    projected = matvec_transposed(jacobian, rate)
    out = (0.0, 0.0, 0.0)
    smallest = np.inf
    for k in range(3):
        value = max(gram.values[k], 0.0)
        smallest = min(smallest, value)
        damped = value
        if value < threshold * threshold:
            damped += damping * damping * (1.0 - value / (threshold * threshold))
        direction = gram.vectors[k]
        component = dot3(direction, fallback)
        if damped > 0.0:
            component = dot3(direction, projected) / damped + (1.0 - value / damped) * component
        out = axpy(component, direction, out)
    return TaskVelocity(out, math.sqrt(smallest))


@kernel
def null_space_projector(jacobian: Array) -> Array:
    """N = I - J^+ J (3, 3) of the stacked rows (r, 3): symmetric and idempotent by construction."""
    out = np.zeros((3, 3))
    if jacobian.shape[0] == 0:
        for i in range(3):
            out[i, i] = 1.0
        return out
    gram = eigen3(gram3(jacobian))
    largest = max(gram.values[0], gram.values[1], gram.values[2])
    for k in range(3):
        if gram.values[k] > RANK_TOLERANCE * largest:
            continue
        for i in range(3):
            for j in range(3):
                out[i, j] += gram.vectors[k][i] * gram.vectors[k][j]
    return out


@kernel
def compose(velocities: Array, jacobians: Array, rows: Array) -> Array:
    """Velocities in strict priority: v = v_1 + sum_l N_{1..l-1} v_l.

    Args:
        velocities: (L, 3) each task's own velocity [m/s, ENU], highest priority first.
        jacobians: (R, 3) the rows of the tasks, stacked in the same order. The rows of the last task are not
            used and may be left out.
        rows: (L,) how many rows each task has; a task may have none.

    Returns:
        (L, 3) the contribution of each task; their sum is the velocity. N is made of the rows of all higher
        tasks, where (11) projects on the next higher task only.
    """
    contributions = np.empty((velocities.shape[0], 3))
    higher = 0
    for level in range(velocities.shape[0]):
        if higher == 0:
            store3(contributions[level], 0, velocities[level])
        else:
            projection = null_space_projector(jacobians[:higher])
            store3(contributions[level], 0, matvec(projection, velocities[level]))
        higher += int(rows[level])
    return contributions


@kernel
def limit_by_priority(contributions: Array, limit: float) -> Vector3:
    """Sum of the contributions (L, 3) within a speed limit [m/s]; the lowest priorities are cut first."""
    total = (0.0, 0.0, 0.0)
    for level in range(contributions.shape[0]):
        fraction = _largest_fraction(total, contributions[level], limit)
        total = axpy(fraction, contributions[level], total)
        if fraction < 1.0:
            break
    return total


@inline_kernel
def _largest_fraction(base: Vector3, addition: Array, limit: float) -> float:
    """Largest s in [0, 1] with |base + s addition| <= limit, for |base| <= limit."""
    a = dot3(addition, addition)
    b = dot3(base, addition)
    c = dot3(base, base) - limit * limit
    if a == 0.0 or a + 2.0 * b + c <= 0.0:
        return 1.0
    return max(0.0, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)


class ComposedVelocity(NamedTuple):
    """Velocity after composition and the speed limit."""

    velocity: Vector3  # [m/s, ENU]
    limited: bool
    violation: float  # [m/s] by how much the limited sum violates the rows of the highest task


@inline_kernel
def compose_with_clearance(clearance: ClearanceTask, max_speed: float) -> ComposedVelocity:
    """Clearance first, the behaviour in its null space, within the speed limit [m/s]."""
    if clearance.jacobian.shape[0] == 0:
        velocity = limit_norm(clearance.secondary, max_speed)
        return ComposedVelocity(velocity, norm3(clearance.secondary) > max_speed, 0.0)
    return _compose_below(clearance, max_speed)


@kernel
def _compose_below(clearance: ClearanceTask, max_speed: float) -> ComposedVelocity:
    count = clearance.jacobian.shape[0]
    velocities = np.empty((2, 3))
    store3(velocities[0], 0, clearance.velocity)
    store3(velocities[1], 0, clearance.secondary)
    rows = np.empty(2)
    rows[0], rows[1] = count, 3
    contributions = compose(velocities, clearance.jacobian, rows)
    out = limit_by_priority(contributions, max_speed)
    cut = sub3(add3(contributions[0], contributions[1]), out)
    largest_cut = max(abs(cut[0]), abs(cut[1]), abs(cut[2]))
    violation = 0.0
    change = sub3(out, clearance.velocity)
    for row in range(count):
        violation = max(violation, abs(dot3(clearance.jacobian[row], change)))
    return ComposedVelocity(out, largest_cut > 1e-9, violation)
