"""Near-object sensor: obstacles and other UAVs within the detection range, and nothing farther.

A sphere and a UAV are in range by their centre, all other bodies by their surface: of these the sensor tells the
sphere that touches the surface at the point nearest to the observer.

Rows are float32-rounded, because that is what a sensor_msgs/PointCloud2 carries and what viewers read: the
headless flight must see the same numbers as a process.
"""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.tasks.signed_distance import (
    BODY_SPHERE,
    KEEP_OUT,
    KIND,
    TANGENT_RADIUS_M,
    VELOCITY,
    signed_distance,
    tangent_centre,
)
from ptnsbc_core.types import NEAR_COLUMNS, Array, Vector3


@kernel
def store_objects(odometry: Array, obstacles: Array, out: Array) -> None:
    """Rows (N + O, 7) of all UAVs, then of all obstacles, into `out`; UAVs without the keep-out, which is a pair's."""
    count = odometry.shape[0]
    for uav in range(count):
        speed = velocity_enu(odometry[uav])
        for i in range(3):
            out[uav, i] = np.float32(odometry[uav, i])
            out[uav, 4 + i] = np.float32(speed[i])
    for which in range(obstacles.shape[0]):
        for i in range(NEAR_COLUMNS):
            out[count + which, i] = np.float32(obstacles[which, i])


@inline_kernel
def _store_tangent(place: Vector3, body: Array, range_m: float, out: Array) -> bool:
    """The sphere that stands for a body seen from `place`, into `out` (7,); whether the body is in range."""
    found = signed_distance(place, body)
    if found.distance > range_m:
        return False
    centre = tangent_centre(place, found)
    out[3] = np.float32(TANGENT_RADIUS_M + body[KEEP_OUT])
    for i in range(3):
        out[i] = np.float32(centre[i])
        out[4 + i] = np.float32(body[VELOCITY + i])
    return True


@kernel
def store_near(
    who: int,
    odometry: Array,
    obstacles: Array,
    objects: Array,
    keep_outs: Array,
    range_m: float,
    out: Array,
) -> int:
    """Rows of `objects` within the range of UAV number `who` into `out` (N - 1 + O, 7); returns their number."""
    count = odometry.shape[0]
    used = 0
    x, y, z = odometry[who, 0], odometry[who, 1], odometry[who, 2]
    for other in range(objects.shape[0]):
        if other == who:
            continue
        if other >= count and int(obstacles[other - count, KIND]) != BODY_SPHERE:
            if _store_tangent((x, y, z), obstacles[other - count], range_m, out[used]):
                used += 1
            continue
        place = odometry[other] if other < count else obstacles[other - count]
        square = (place[0] - x) ** 2 + (place[1] - y) ** 2 + (place[2] - z) ** 2
        if math.sqrt(square) > range_m:
            continue
        for i in range(NEAR_COLUMNS):
            out[used, i] = objects[other, i]
        if other < count:
            out[used, 3] = np.float32(0.5 * (keep_outs[who] + keep_outs[other]))
        used += 1
    return used


@kernel
def near_objects(
    who: int, odometry: Array, obstacles: Array, keep_outs: Array, range_m: float
) -> Array:
    """Rows (M, 7) x y z keep-out vx vy vz [m, m/s, ENU] that UAV number `who` (row) sees within `range_m`.

    `odometry` (N, 13) is of all UAVs, `obstacles` (O, 20) are rows of bodies. The keep-out of a pair of UAVs is the
    mean of its `keep_outs` (N,) [m].
    """
    objects = np.empty((odometry.shape[0] + obstacles.shape[0], NEAR_COLUMNS))
    store_objects(odometry, obstacles, objects)
    found = np.empty((objects.shape[0] - 1, NEAR_COLUMNS))
    used = store_near(who, odometry, obstacles, objects, keep_outs, range_m, found)
    return found[:used].copy()
