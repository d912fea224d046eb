"""Task `relative_position`: sigma = p_i - p_j [m, ENU], J = I. Never singular: the robust reference."""

from __future__ import annotations

from ptnsbc_core.algebra import minus
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.contract import FIXED, TaskGeometry
from ptnsbc_core.types import Triple


@kernel
def relative_position(own: Triple, parent: Triple, reference: Triple) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]; the reference takes no part."""
    with_own = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    with_parent = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    return TaskGeometry(minus(own, parent), with_own, with_parent, FIXED, (0.0, 0.0, 0.0))
