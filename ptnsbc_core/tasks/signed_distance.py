"""Signed distances of bodies with their gradients, and the sphere that stands for a body in the clearance task.

Signed distance d(x) [m]: from the surface, negative inside. Its gradient is the unit vector along which it grows.
Of every body but a sphere the near-object sensor tells one sphere of radius TANGENT_RADIUS_M, which touches the surface
at the point nearest to the UAV, see docs/notes/bodies.md.

The keep-out of a UAV may be an ellipsoid, higher than it is wide, because of its downwash: `flat` is its width over its
height. Where heights count `flat` times, it is a sphere (`flattened`). `slope` brings a direction of that space to the
world.

Positions [m] are world ENU.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.algebra import axpy, load3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Array, Vector3, Vector3Like

BODY_SPHERE, BODY_BOX, BODY_CYLINDER, BODY_HALF_SPACE, BODY_PLANE = 0, 1, 2, 3, 4
BODIES = {
    "sphere": BODY_SPHERE,
    "box": BODY_BOX,
    "cylinder": BODY_CYLINDER,
    "half_space": BODY_HALF_SPACE,
    "plane": BODY_PLANE,
}

KEEP_OUT, VELOCITY, KIND, SIZE, AXES = 3, 4, 7, 8, 11
BODY_COLUMNS = 20
"""A body as a row: x y z, keep-out, velocity, kind, size (3), axes (9).

Of a sphere the keep-out counts from its centre, of all others from the surface. Size: half edges of a box; radius and
half height of a cylinder, which may be infinite. Axes: rotation matrix, row by row, from the axes of the body to the
world; the third axis is that of a cylinder and the outward normal of a half-space or plane.
"""

TANGENT_RADIUS_M = 100.0
"""Radius of the sphere that stands for a body."""

_TINY = 1e-12


class SignedDistance(NamedTuple):
    """Signed distance of a body at one place."""

    distance: float  # [m]
    gradient: Vector3  # unit vector away from the body


@inline_kernel
def _signed(number: float) -> float:
    return -1.0 if number < 0.0 else 1.0


@inline_kernel
def sphere_distance(place: Vector3Like, radius: float) -> SignedDistance:
    """Of a sphere around the origin; in its centre the gradient is that along x."""
    length = math.sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2])
    if length < _TINY:
        return SignedDistance(0.0 - radius, (1.0, 0.0, 0.0))
    return SignedDistance(
        length - radius, (place[0] / length, place[1] / length, place[2] / length)
    )


@kernel
def box_distance(place: Vector3Like, half: Vector3Like) -> SignedDistance:
    """Of a box with half edges `half` (3,) around the origin; inside, the nearest face counts."""
    x, y, z = abs(place[0]) - half[0], abs(place[1]) - half[1], abs(place[2]) - half[2]
    a, b, c = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    outside = math.sqrt(a * a + b * b + c * c)
    if outside > 0.0:
        gradient = (
            _signed(place[0]) * a / outside,
            _signed(place[1]) * b / outside,
            _signed(place[2]) * c / outside,
        )
        return SignedDistance(outside, gradient)
    if x >= y and x >= z:
        return SignedDistance(x, (_signed(place[0]), 0.0, 0.0))
    if y >= z:
        return SignedDistance(y, (0.0, _signed(place[1]), 0.0))
    return SignedDistance(z, (0.0, 0.0, _signed(place[2])))


@kernel
def cylinder_distance(place: Vector3Like, radius: float, half_height: float) -> SignedDistance:
    """Of a cylinder along z around the origin; `half_height` may be infinite."""
    level = math.sqrt(place[0] * place[0] + place[1] * place[1])
    out = (1.0, 0.0)
    if level > _TINY:
        out = (place[0] / level, place[1] / level)
    beside, above = level - radius, abs(place[2]) - half_height
    if beside > 0.0 and above > 0.0:
        distance = math.sqrt(beside * beside + above * above)
        along, up = beside / distance, above / distance
        return SignedDistance(distance, (along * out[0], along * out[1], up * _signed(place[2])))
    if beside >= above:
        return SignedDistance(beside, (out[0], out[1], 0.0))
    return SignedDistance(above, (0.0, 0.0, _signed(place[2])))


@kernel
def signed_distance(place: Vector3Like, body: Array) -> SignedDistance:
    """Of a body in a row (20,) at a place (3,)."""
    kind, axes = int(body[KIND]), AXES
    away = sub3(place, load3(body, 0))
    if kind == BODY_SPHERE:
        return sphere_distance(away, 0.0)
    x, y, z = load3(body, axes), load3(body, axes + 3), load3(body, axes + 6)
    # in the axes of the body: the transpose of the rotation times the way from its centre
    local = (
        x[0] * away[0] + y[0] * away[1] + z[0] * away[2],
        x[1] * away[0] + y[1] * away[1] + z[1] * away[2],
        x[2] * away[0] + y[2] * away[1] + z[2] * away[2],
    )
    if kind == BODY_BOX:
        nearest = box_distance(local, load3(body, SIZE))
    elif kind == BODY_CYLINDER:
        nearest = cylinder_distance(local, body[SIZE], body[SIZE + 1])
    elif kind == BODY_PLANE:
        nearest = SignedDistance(abs(local[2]), (0.0, 0.0, _signed(local[2])))
    else:
        nearest = SignedDistance(local[2], (0.0, 0.0, 1.0))
    g = nearest.gradient
    gradient = (
        x[0] * g[0] + x[1] * g[1] + x[2] * g[2],
        y[0] * g[0] + y[1] * g[1] + y[2] * g[2],
        z[0] * g[0] + z[1] * g[1] + z[2] * g[2],
    )
    return SignedDistance(nearest.distance, gradient)


@kernel
def signed_distances(places: Array, body: Array) -> Array:
    """Signed distances (T,) [m] of one body at places (T, 3); of a sphere from its centre."""
    out = places[:, 0].copy()
    for k in range(places.shape[0]):
        out[k] = signed_distance(load3(places[k], 0), body).distance
    return out


class Slope(NamedTuple):
    """A distance in which heights count `flat` times, in the world."""

    normal: Vector3  # unit vector along which it grows
    rate: float  # by which it grows per metre along the normal, from `flat` to 1


@inline_kernel
def flattened(away: Vector3Like, flat: float) -> Vector3:
    """A vector whose height counts `flat` times."""
    return away[0], away[1], flat * away[2]


@inline_kernel
def slope(normal: Vector3Like, flat: float) -> Slope:
    """Of a distance that grows along a unit vector (3,) of the space where heights count `flat` times."""
    rate = math.sqrt(1.0 - (1.0 - flat * flat) * normal[2] * normal[2])  # exactly 1 for a sphere
    return Slope((normal[0] / rate, normal[1] / rate, flat * normal[2] / rate), rate)


@inline_kernel
def tangent_centre(place: Vector3Like, nearest: SignedDistance) -> Vector3:
    """Centre of the sphere of TANGENT_RADIUS_M that touches a body at the point of its surface nearest to `place`."""
    return axpy(-(nearest.distance + TANGENT_RADIUS_M), nearest.gradient, place)
