"""Task `distance_angles`, (23): distance to the parent, angles parent-own-reference in XOY and XOZ.

sigma = [|p_i - p_j|, angle from p_j - p_i to p_k - p_i in XOY, the same in XOZ]; world ENU, metres and radians,
angles counted counter-clockwise from the parent to the reference. Jacobians replace (26)-(29), which divide
by zero when the three are collinear. Singular when the angle at k is 90 degrees (docs/method.md).
"""

from __future__ import annotations

from ptnsbc_core.algebra import div3, norm3, scale3, sub3
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.tasks.angles import signed_angle
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Vector3Like


@inline_kernel
def distance_angles(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
    """Evaluate the task at positions (3,) [m, ENU]."""
    away = sub3(own, parent)
    distance = norm3(away)
    outwards = div3(away, max(distance, 1e-9))
    back, ahead = sub3(parent, own), sub3(reference, own)
    flat = signed_angle((back[0], back[1]), (ahead[0], ahead[1]))
    upright = signed_angle((back[0], back[2]), (ahead[0], ahead[2]))
    (fax, fay), (fbx, fby) = flat.d_a, flat.d_b
    (uax, uaz), (ubx, ubz) = upright.d_a, upright.d_b
    return TaskGeometry(
        (distance, flat.angle, upright.angle),
        (outwards, (-(fax + fbx), -(fay + fby), 0.0), (-(uax + ubx), 0.0, -(uaz + ubz))),
        (scale3(-1.0, outwards), (fax, fay, 0.0), (uax, 0.0, uaz)),
        ((0.0, 0.0, 0.0), (fbx, fby, 0.0), (ubx, 0.0, ubz)),
        (0.0, 1.0, 1.0),
    )
