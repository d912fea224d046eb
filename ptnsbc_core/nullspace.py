"""Null-space composition (7)-(11), (18)-(22), (37), (38) for any number of tasks, equations.md section 3.

Everything here is a world-frame velocity of one UAV (3,) [m/s, ENU]; Theta^-1 is applied once, later.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import dot3, eigen3, gram3, moved, put3, times, transpose_times
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.types import Array, Matrix3, Vector3

RANK_TOLERANCE = 1e-9
"""Share of the largest eigenvalue of the Gram matrix below which a direction counts as free."""


class Solution(NamedTuple):
    """Velocity of a task, and how well the task determines it."""

    velocity: Vector3  # [m/s, ENU]
    singular_value: float  # smallest of the Jacobian


@kernel
def damped_solve(
    jacobian: Matrix3, rate: Vector3, fallback: Vector3, threshold: float, damping: float
) -> Solution:
    """J^+ rate + (I - J^+ J) fallback with the pseudo-inverse damped near a singularity.

    Each singular value s below `threshold` is damped by damping^2 (1 - (s/threshold)^2); what the damping
    takes away from the task, a lower-priority velocity `fallback` fills. Away from singularities J^+ J is
    the identity and the fallback has no say. Singular values come from the Gram matrix: for three unknowns
    that is the decomposition of the design without LAPACK.
    """
    parts = eigen3(gram3(jacobian))
    pulled = transpose_times(jacobian, rate)
    out = (0.0, 0.0, 0.0)
    smallest = np.inf
    for k in range(3):
        value = max(parts.values[k], 0.0)
        smallest = min(smallest, value)
        damped = value
        if value < threshold * threshold:
            damped += damping * damping * (1.0 - value / (threshold * threshold))
        direction = (parts.vectors[0, k], parts.vectors[1, k], parts.vectors[2, k])
        along = dot3(direction, fallback)
        if damped > 0.0:
            along = dot3(direction, pulled) / damped + (1.0 - value / damped) * along
        out = moved(out, along, direction)
    return Solution(out, math.sqrt(smallest))


@kernel
def projector(jacobian: Array) -> Array:
    """N = I - J^+ J (3, 3) of the stacked rows (r, 3): symmetric and idempotent by construction."""
    out = np.zeros((3, 3))
    if jacobian.shape[0] == 0:
        for i in range(3):
            out[i, i] = 1.0
        return out
    parts = eigen3(gram3(jacobian))
    largest = max(parts.values[0], parts.values[1], parts.values[2])
    for k in range(3):
        if parts.values[k] > RANK_TOLERANCE * largest:
            continue
        for i in range(3):
            for j in range(3):
                out[i, j] += parts.vectors[i, k] * parts.vectors[j, k]
    return out


@kernel
def compose(velocities: Array, jacobians: Array, rows: Array) -> Array:
    """Velocities in strict priority: v = v_1 + sum_l N_{1..l-1} v_l.

    Args:
        velocities: (L, 3) each task's own velocity [m/s, ENU], highest priority first.
        jacobians: (R, 3) the rows of the tasks stacked in the same order; nobody is below the last one, whose
            rows may be left out.
        rows: (L,) how many rows each task has; a task may have none.

    Returns:
        (L, 3) the contribution of each task; their sum is the velocity. N comes from all rows above, where
        (11) projects on one level only.
    """
    parts = np.empty((velocities.shape[0], 3))
    above = 0
    for level in range(velocities.shape[0]):
        if above == 0:
            put3(parts[level], 0, velocities[level])
        else:
            put3(parts[level], 0, times(projector(jacobians[:above]), velocities[level]))
        above += int(rows[level])
    return parts


@kernel
def scaled_to_limit(parts: Array, limit: float) -> Vector3:
    """Sum of the parts (L, 3) within a speed limit [m/s]; the lowest priorities give way first."""
    total = (0.0, 0.0, 0.0)
    for level in range(parts.shape[0]):
        room = _share_within(total, parts[level], limit)
        total = moved(total, room, parts[level])
        if room < 1.0:
            break
    return total


@leaf
def _share_within(base: Vector3, addition: Array, limit: float) -> float:
    """Largest s in [0, 1] with |base + s addition| <= limit, for |base| <= limit."""
    a = dot3(addition, addition)
    b = dot3(base, addition)
    c = dot3(base, base) - limit * limit
    if a == 0.0 or a + 2.0 * b + c <= 0.0:
        return 1.0
    return max(0.0, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)
