"""Task `parent_angle`: distance to the parent, angle at the parent, height above the parent.

sigma = [|p_i - p_j|, angle from p_k - p_j to p_i - p_j in XOY, z_i - z_j]; world ENU, metres and radians. The
same rigidity as (23), and its smallest singular value is min(1, 1/rho) in a flat formation, rho the
horizontal distance to the parent: it never vanishes where (23) does.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import minus, norm3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.angles import signed_angle
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Array


@kernel
def parent_angle(own: Array, parent: Array, reference: Array) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]."""
    value = np.empty(3)
    j_own = np.zeros((3, 3))
    j_parent = np.zeros((3, 3))
    j_reference = np.zeros((3, 3))
    periodic = np.zeros(3)
    periodic[1] = 1.0
    away = minus(own, parent)
    distance = norm3(away)
    value[0] = distance
    at = signed_angle(minus(reference, parent), away, 0, 1)
    value[1] = at.angle
    for i in range(3):
        j_own[0, i] = away[i] / max(distance, 1e-9)
        j_parent[0, i] = -j_own[0, i]
        j_own[1, i] = at.d_b[i]
        j_parent[1, i] = -(at.d_a[i] + at.d_b[i])
        j_reference[1, i] = at.d_a[i]
    value[2] = away[2]
    j_own[2, 2] = 1.0
    j_parent[2, 2] = -1.0
    return TaskGeometry(value, j_own, j_parent, j_reference, periodic)
