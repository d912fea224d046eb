"""Near-object sensor: obstacles and other UAVs within the detection range, and nothing farther.

Rows are float32-rounded, because that is what a sensor_msgs/PointCloud2 carries and what viewers read: the
headless flight must see the same numbers as a process.
"""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import NEAR_COLUMNS, Array


@kernel
def near_objects(
    who: int, odometry: Array, obstacles: Array, uav_keep_out_m: float, range_m: float
) -> Array:
    """Rows (M, 7) x y z keep-out vx vy vz [m, m/s, ENU] that UAV number `who` (row) sees.

    Args:
        who: row of the observer.
        odometry: (N, 13) odometry vectors of all UAVs.
        obstacles: (O, 7) rows of the obstacles.
        uav_keep_out_m: keep-out radius of a UAV [m].
        range_m: detection range to the centre [m].
    """
    count = odometry.shape[0]
    found = np.empty((count + obstacles.shape[0], NEAR_COLUMNS))
    used = 0
    own = odometry[who]
    for other in range(count + obstacles.shape[0]):
        if other == who:
            continue
        row = odometry[other] if other < count else obstacles[other - count]
        square = (row[0] - own[0]) ** 2 + (row[1] - own[1]) ** 2 + (row[2] - own[2]) ** 2
        if math.sqrt(square) > range_m:
            continue
        for i in range(3):
            found[used, i] = np.float32(row[i])
        if other < count:
            speed = velocity_enu(row)
            found[used, 3] = np.float32(uav_keep_out_m)
            for i in range(3):
                found[used, 4 + i] = np.float32(speed[i])
        else:
            for i in range(3, NEAR_COLUMNS):
                found[used, i] = np.float32(row[i])
        used += 1
    return found[:used].copy()
