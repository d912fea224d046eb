"""Data association: which near object is a given neighbour.

This is not one of the paper's laws; in its experiment the UAVs detect each other by their own sensors. Two UAVs
that localise themselves by satellite have independent errors. A formation built from two such positions is off by
both errors, however good the control is. The sensor places an object relative to the UAV's own position. The
UAV's own position error is then in both ends of the difference and cancels. The same holds for velocities.
"""

from __future__ import annotations

from ptnsbc_core.algebra import axpy, load3, norm3, sub3
from ptnsbc_core.behaviours.contract import Neighbour
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.signed_distance import TANGENT_RADIUS_M
from ptnsbc_core.types import Array


@kernel
def associate(reported: Neighbour, near: Array, near_age_s: float, gate_m: float) -> Neighbour:
    """The near object nearest to a neighbour's reported position, or the report without such an object.

    Args:
        reported: position and velocity that the neighbour reports, extrapolated to the present.
        near: (M, 7) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU].
        near_age_s: age of `near`, by which its objects are extrapolated.
        gate_m: an object at this distance or farther from the reported position is not the neighbour.
    """
    least, neighbour = gate_m, reported
    for row in range(near.shape[0]):
        if near[row, 3] >= TANGENT_RADIUS_M:
            continue  # it stands for a wall: its centre is nowhere
        velocity = load3(near[row], 4)
        position = axpy(near_age_s, velocity, near[row])
        distance = norm3(sub3(position, reported.position))
        if distance < least:
            least, neighbour = (
                distance,
                Neighbour(position, velocity, reported.acceleration, reported.delay_s),
            )
    return neighbour
