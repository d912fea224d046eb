"""Task `distance_angles`, (23): distance to the parent, angles parent-own-reference in XOY and XOZ.

sigma = [|p_i - p_j|, angle from p_j - p_i to p_k - p_i in XOY, the same in XOZ]; world ENU, metres and radians,
angles counted counter-clockwise from the parent to the reference. Jacobians replace (26)-(29), which divide
by zero when the three are collinear. Singular when the angle at k is 90 degrees (equations.md section 4).
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import minus, norm3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.angles import signed_angle
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Array


@kernel
def distance_angles(own: Array, parent: Array, reference: Array) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]."""
    value = np.empty(3)
    j_own = np.empty((3, 3))
    j_parent = np.empty((3, 3))
    j_reference = np.zeros((3, 3))
    periodic = np.ones(3)
    periodic[0] = 0.0
    away = minus(own, parent)
    distance = norm3(away)
    value[0] = distance
    for i in range(3):
        j_own[0, i] = away[i] / max(distance, 1e-9)
        j_parent[0, i] = -j_own[0, i]
    to_parent = minus(parent, own)
    to_reference = minus(reference, own)
    for row in range(1, 3):
        at = signed_angle(to_parent, to_reference, 0, row)
        value[row] = at.angle
        for i in range(3):
            j_own[row, i] = -(at.d_a[i] + at.d_b[i])
            j_parent[row, i] = at.d_a[i]
            j_reference[row, i] = at.d_b[i]
    return TaskGeometry(value, j_own, j_parent, j_reference, periodic)
