"""Null-space composition (7)-(11), (18)-(22), (37), (38) for any number of tasks, equations.md section 3.

Everything here is a world-frame velocity of one UAV (3,) [m/s, ENU]; Theta^-1 is applied once, later.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import eigen3, gram3, put, times, transpose_times
from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array

RANK_TOLERANCE = 1e-9
"""Share of the largest eigenvalue of the Gram matrix below which a direction counts as free."""


class Solution(NamedTuple):
    """Velocity of a task, and how well the task determines it."""

    velocity: Array  # (3,) [m/s, ENU]
    singular_value: float  # smallest of the Jacobian


@kernel
def damped_solve(
    jacobian: Array, rate: Array, fallback: Array, threshold: float, damping: float
) -> Solution:
    """J^+ rate + (I - J^+ J) fallback with the pseudo-inverse damped near a singularity.

    Each singular value s below `threshold` is damped by damping^2 (1 - (s/threshold)^2); what the damping
    takes away from the task, a lower-priority velocity `fallback` (3,) fills. Away from singularities J^+ J is
    the identity and the fallback has no say. Singular values come from the Gram matrix: for three unknowns
    that is the decomposition of the design without LAPACK.
    """
    parts = eigen3(gram3(jacobian))
    pulled = transpose_times(jacobian, rate)
    out = np.zeros(3)
    smallest = np.inf
    for k in range(3):
        value = max(parts.values[k], 0.0)
        smallest = min(smallest, value)
        damped = value
        if value < threshold * threshold:
            damped += damping * damping * (1.0 - value / (threshold * threshold))
        seen = 0.0
        free = 0.0
        for i in range(3):
            seen += parts.vectors[i, k] * pulled[i]
            free += parts.vectors[i, k] * fallback[i]
        if damped > 0.0:
            free = seen / damped + (1.0 - value / damped) * free
        for i in range(3):
            out[i] += parts.vectors[i, k] * free
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
        jacobians: (R, 3) the rows of all tasks stacked in the same order.
        rows: (L,) how many rows each task has; a task may have none.

    Returns:
        (L, 3) the contribution of each task; their sum is the velocity. N comes from all rows above, where
        (11) projects on one level only.
    """
    parts = np.empty((velocities.shape[0], 3))
    above = 0
    for level in range(velocities.shape[0]):
        if above == 0:
            put(parts[level], 0, velocities[level])
        else:
            put(parts[level], 0, times(projector(jacobians[:above]), velocities[level]))
        above += int(rows[level])
    return parts


@kernel
def scaled_to_limit(parts: Array, limit: float) -> Array:
    """Sum of the parts (L, 3) within a speed limit [m/s]; the lowest priorities give way first."""
    total = np.zeros(3)
    for level in range(parts.shape[0]):
        room = _share_within(total, parts[level], limit)
        for i in range(3):
            total[i] += room * parts[level, i]
        if room < 1.0:
            break
    return total


@kernel
def _share_within(base: Array, addition: Array, limit: float) -> float:
    """Largest s in [0, 1] with |base + s addition| <= limit, for |base| <= limit."""
    a = addition[0] * addition[0] + addition[1] * addition[1] + addition[2] * addition[2]
    b = base[0] * addition[0] + base[1] * addition[1] + base[2] * addition[2]
    c = base[0] * base[0] + base[1] * base[1] + base[2] * base[2] - limit * limit
    if a == 0.0 or a + 2.0 * b + c <= 0.0:
        return 1.0
    return max(0.0, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)
