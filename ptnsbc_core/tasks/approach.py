"""The speed at which a UAV may come near an object: the braking that it has, and the velocities that end in a keep-out.

Positions [m] and velocities [m/s] are world ENU, docs/notes/clearance.md ("The bound").
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.algebra import add3, axpy, div3, dot3, norm3, scale3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Vector3, Vector3Like

LATENCIES = 4.0
"""T per lag tau: the bound has the slope 1/T at the keep-out, and a lag tau overshoots for slopes above 1/(4 tau)."""

SHARE = 0.5
"""Part of a change of relative velocity that a UAV makes when the other one moves too."""

COMMON = 0.5
"""Part of the UAV's deviation from its command that it takes the other one to have as well."""

_ASIDE = 0.3
"""Tangent of the angle within which a straight meeting is passed on the common side."""

_TINY = 1e-9


@inline_kernel
def braking_speed(room: float, deceleration: float, latency_s: float) -> float:
    """Largest closing speed [m/s] at `room` [m] >= 0: sqrt((a T)^2 + 2 a room) - a T."""
    lost = deceleration * latency_s
    return 2.0 * deceleration * room / (math.sqrt(lost * lost + 2.0 * deceleration * room) + lost)


@inline_kernel
def homing_speed(distance: float, gain: float, deceleration: float) -> float:
    """Largest speed [m/s] towards a place `distance` [m] away: gain times it, as far as that can be braked.

    Beyond deceleration / gain^2 the speed is sqrt(2 a (distance - a / (2 gain^2))), whose braking is constant.
    """
    near = deceleration / max(gain * gain, _TINY)
    if distance <= near:
        return gain * distance
    return math.sqrt(2.0 * deceleration * (distance - 0.5 * near))


@kernel
def tangent(normal: Vector3Like) -> Vector3:
    """Unit vector along e_z x n, or e_x x n where n is nearly vertical."""
    length = math.hypot(normal[0], normal[1])
    if length > 0.1:
        return -normal[1] / length, normal[0] / length, 0.0
    length = math.hypot(normal[1], normal[2])
    return 0.0, -normal[2] / length, normal[1] / length


class HalfSpace(NamedTuple):
    """normal . v >= bound."""

    normal: Vector3
    bound: float  # [m/s]


@kernel
def clear_velocities(
    away: Vector3, keep_out: float, relative: Vector3, allowed: float
) -> HalfSpace:
    """Relative velocities that stay clear of a sphere, linearised at the present one.

    The velocities that enter the sphere within the braking horizon room / allowed are a cone with a spherical
    tip, whose nearest point is `allowed` away from rest. The half space touches it where it is nearest to the
    present relative velocity. On a straight meeting that is beside the object, on the right-hand side: both
    UAVs of a pair choose the same sense of rotation.

    Args:
        away: (3,) from the object to the UAV [m], longer than `keep_out`.
        keep_out: radius of the sphere [m].
        relative: (3,) velocity of the UAV beside that of the object [m/s].
        allowed: closing speed straight to the object [m/s], above 0.
    """
    distance = norm3(away)
    rate = allowed / (distance - keep_out)  # 1 / horizon
    ahead = scale3(-1.0, away)
    toward = scale3(rate, ahead)
    normal = div3(away, distance)
    offset = sub3(relative, toward)
    along = dot3(offset, ahead)
    length = norm3(offset)
    if along < 0.0 and along * along > keep_out * keep_out * length * length:
        side = div3(offset, length)  # beside the tip
        return HalfSpace(side, dot3(side, toward) + keep_out * rate)
    closing = dot3(relative, ahead) / distance
    lateral = axpy(closing, normal, relative)
    lateral = axpy(_ASIDE * max(closing, 0.0), tangent(normal), lateral)
    across = norm3(lateral)
    lateral = div3(lateral, across) if across > _TINY else tangent(normal)
    sine = keep_out / distance
    side = add3(
        scale3(math.sqrt(1.0 - sine * sine), lateral), scale3(sine, normal)
    )  # outward normal of the cone
    return HalfSpace(side, 0.0)
