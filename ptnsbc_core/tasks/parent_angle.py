"""Task `parent_angle`: distance to the parent, angle at the parent, height above the parent.

sigma = [|p_i - p_j|, angle from p_k - p_j to p_i - p_j in XOY, z_i - z_j]; world ENU, metres and radians. The
same rigidity as (23), and its smallest singular value is min(1, 1/rho) in a flat formation, rho the
horizontal distance to the parent: it never vanishes where (23) does.
"""

from __future__ import annotations

from ptnsbc_core.algebra import divided, minus, norm3, scaled
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.angles import signed_angle
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Triple


@kernel
def parent_angle(own: Triple, parent: Triple, reference: Triple) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]."""
    away = minus(own, parent)
    distance = norm3(away)
    outwards = divided(away, max(distance, 1e-9))
    ahead = minus(reference, parent)
    at = signed_angle((ahead[0], ahead[1]), (away[0], away[1]))
    (ax, ay), (bx, by) = at.d_a, at.d_b
    return TaskGeometry(
        (distance, at.angle, away[2]),
        (outwards, (bx, by, 0.0), (0.0, 0.0, 1.0)),
        (scaled(-1.0, outwards), (-(ax + bx), -(ay + by), 0.0), (0.0, 0.0, -1.0)),
        ((0.0, 0.0, 0.0), (ax, ay, 0.0), (0.0, 0.0, 0.0)),
        (0.0, 1.0, 0.0),
    )
