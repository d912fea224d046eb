"""Task `parent_angle`: distance to the parent, angle at the parent, height above the parent.

sigma = [|p_i - p_j|, angle from p_k - p_j to p_i - p_j in XOY, z_i - z_j]; world ENU, metres and radians. The
same rigidity as (23), and its smallest singular value is min(1, 1/rho) in a flat formation, rho the
horizontal distance to the parent: it never vanishes where (23) does.
"""

from __future__ import annotations

from ptnsbc_core.algebra import div3, norm3, scale3, sub3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.angles import signed_angle
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Vector3Like


@kernel
def parent_angle(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]."""
    away = sub3(own, parent)
    distance = norm3(away)
    outwards = div3(away, max(distance, 1e-9))
    ahead = sub3(reference, parent)
    at = signed_angle((ahead[0], ahead[1]), (away[0], away[1]))
    (ax, ay), (bx, by) = at.d_a, at.d_b
    return TaskGeometry(
        (distance, at.angle, away[2]),
        (outwards, (bx, by, 0.0), (0.0, 0.0, 1.0)),
        (scale3(-1.0, outwards), (-(ax + bx), -(ay + by), 0.0), (0.0, 0.0, -1.0)),
        ((0.0, 0.0, 0.0), (ax, ay, 0.0), (0.0, 0.0, 0.0)),
        (0.0, 1.0, 0.0),
    )
