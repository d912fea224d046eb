"""Task `relative_position`: sigma = p_i - p_j [m, ENU], J = I. Never singular: the robust reference."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import minus
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Array


@kernel
def relative_position(own: Array, parent: Array, reference: Array) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]; the reference takes no part."""
    j_own = np.zeros((3, 3))
    j_parent = np.zeros((3, 3))
    for i in range(3):
        j_own[i, i] = 1.0
        j_parent[i, i] = -1.0
    return TaskGeometry(minus(own, parent), j_own, j_parent, np.zeros((3, 3)), np.zeros(3))
