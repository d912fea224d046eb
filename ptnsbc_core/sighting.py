"""What the own sensor says of a neighbour, against what the neighbour says of itself.

Not among the paper's laws; in its experiment UAVs detect each other by their own sensors. Two UAVs that place
themselves by satellite are wrong independently of each other, and a formation made of two such places is off
by both errors, however good the control. What the sensor sees is placed from the own position: the own error
is in both ends of the difference, and cancels. The same goes for velocities.
"""

from __future__ import annotations

from ptnsbc_core.algebra import minus, moved, norm3, three
from ptnsbc_core.kernel import kernel
from ptnsbc_core.planner import Neighbour
from ptnsbc_core.types import Array


@kernel
def sighted(told: Neighbour, near: Array, near_age_s: float, within_m: float) -> Neighbour:
    """A neighbour as seen from here: the nearest near object to where it says it is, or what it says.

    Args:
        told: what it says of itself, moved on to the present.
        near: (M, 7) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU].
        near_age_s: age of `near`, by which its objects are moved on.
        within_m: objects farther from where it says it is are others; with none left, or 0, `told` counts.
    """
    closest, found = within_m, told
    for row in range(near.shape[0]):
        velocity = three(near[row], 4)
        position = moved(near[row], near_age_s, velocity)
        distance = norm3(minus(position, told.position))
        if distance < closest:
            closest, found = distance, Neighbour(position, velocity)
    return found
