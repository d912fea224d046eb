"""Near-object sensor: obstacles and other UAVs within the detection range, and nothing farther.

A sphere and a UAV are in range by their centre, all other bodies by their surface: of these the sensor tells the
sphere that touches the surface at the point nearest to the observer.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import load3, norm3, store3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.tasks.near_constraints import ABOVE
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


@inline_kernel
def _store_body(place: Vector3, body: Array, range_m: float, out: Array) -> bool:
    """The sphere that a body is seen as from `place`, into `out` (8,); whether the body is in range."""
    centre, distance, radius = load3(body, 0), 0.0, 0.0
    if int(body[KIND]) == BODY_SPHERE:
        distance = norm3(sub3(centre, place))
    else:
        found = signed_distance(place, body)
        centre, distance, radius = tangent_centre(place, found), found.distance, TANGENT_RADIUS_M
    store3(out, 0, centre)
    out[3] = radius + body[KEEP_OUT]
    store3(out, 4, load3(body, VELOCITY))
    out[ABOVE] = 0.0
    return distance <= range_m


@kernel
def store_near(
    who: int, odometry: Array, obstacles: Array, keep_outs: Array, range_m: float, out: Array
) -> int:
    """As `near_objects`, into `out` (N - 1 + O, 8); returns the number of rows."""
    used, place = 0, load3(odometry[who], 0)
    for other in range(odometry.shape[0]):
        centre = load3(odometry[other], 0)
        if other != who and norm3(sub3(centre, place)) <= range_m:
            store3(out[used], 0, centre)
            out[used, 3] = 0.5 * (keep_outs[who, 0] + keep_outs[other, 0])
            store3(out[used], 4, velocity_enu(odometry[other]))
            out[used, ABOVE] = 0.5 * (keep_outs[who, 1] + keep_outs[other, 1])
            used += 1
    for body in obstacles:
        if _store_body(place, body, range_m, out[used]):
            used += 1
    return used


@kernel
def near_objects(
    who: int, odometry: Array, obstacles: Array, keep_outs: Array, range_m: float
) -> Array:
    """Rows (M, 8) x y z keep-out vx vy vz above [m, m/s, ENU] that UAV number `who` (row) sees within `range_m`.

    `odometry` (N, 13) is of all UAVs, `obstacles` (O, 20) are rows of bodies. The keep-out of a pair of UAVs is the
    mean of its `keep_outs` (N, 2) [m], beside and above; above 0 stands for a sphere.
    """
    found = np.empty((odometry.shape[0] - 1 + obstacles.shape[0], NEAR_COLUMNS))
    return found[: store_near(who, odometry, obstacles, keep_outs, range_m, found)].copy()
