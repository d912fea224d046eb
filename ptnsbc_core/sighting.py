"""What the own sensor says of a neighbour, against what the neighbour says of itself.

Not among the paper's laws; in its experiment UAVs detect each other by their own sensors. Two UAVs that place
themselves by satellite are wrong independently of each other, and a formation made of two such places is off
by both errors, however good the control. What the sensor sees is placed from the own position: the own error
is in both ends of the difference, and cancels. The same goes for velocities.
"""

from __future__ import annotations

import math

import numpy as np

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
    closest, found = within_m, -1
    for row in range(near.shape[0]):
        square = 0.0
        for i in range(3):
            square += (near[row, i] + near_age_s * near[row, 4 + i] - told.position[i]) ** 2
        if math.sqrt(square) < closest:
            closest, found = math.sqrt(square), row
    if found < 0:
        return told
    position, velocity = np.empty(3), np.empty(3)
    for i in range(3):
        velocity[i] = near[found, 4 + i]
        position[i] = near[found, i] + near_age_s * velocity[i]
    return Neighbour(position, velocity)
