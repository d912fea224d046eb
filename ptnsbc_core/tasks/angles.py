"""Signed angle between two projected vectors, and its gradients: shared by the angle tasks."""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.types import Vector2

SOFTENING_M2 = 0.05**2
"""Added to squared projected lengths: the gradient of an angle stays below 10 rad/m when points coincide."""

_LONG_M2 = 0.1
"""A squared length above which what is added, 0.05^2 exp(-40) at most, is below half a unit in its last place."""


class SignedAngle(NamedTuple):
    """Angle from a to b in a plane and its gradients with respect to both."""

    angle: float  # [rad], (-pi, pi]
    d_a: Vector2  # [rad/m]
    d_b: Vector2  # [rad/m]


@inline_kernel
def softened(square: float) -> float:
    """A squared length [m^2], which stays above 0."""
    if square > _LONG_M2:
        return square
    return square + SOFTENING_M2 * math.exp(-square / SOFTENING_M2)


@inline_kernel
def signed_angle(a: Vector2, b: Vector2) -> SignedAngle:
    """Angle from a to b, vectors projected on a plane: atan2(a x b, a . b) in place of (24).

    The gradients are those of the design's rule, (-Q0 a)^T/|a|^2 and (Q0 b)^T/|b|^2, softened where a
    projection vanishes (Table 2: UAV 2 and 3 share x and z).
    """
    angle = math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    length_a = a[0] * a[0] + a[1] * a[1]
    length_b = b[0] * b[0] + b[1] * b[1]
    soft_a, soft_b = softened(length_a), softened(length_b)
    return SignedAngle(angle, (a[1] / soft_a, -a[0] / soft_a), (-b[1] / soft_b, b[0] / soft_b))
