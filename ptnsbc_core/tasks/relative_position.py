"""Task `relative_position`: sigma = p_i - p_j [m, ENU], J = I. Never singular: the robust reference."""

from __future__ import annotations

from ptnsbc_core.algebra import sub3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.contract import ZERO, TaskGeometry
from ptnsbc_core.types import Vector3Like


@kernel
def relative_position(
    own: Vector3Like, parent: Vector3Like, reference: Vector3Like
) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]; the reference is not used."""
    with_own = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    with_parent = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    return TaskGeometry(sub3(own, parent), with_own, with_parent, ZERO, (0.0, 0.0, 0.0))
