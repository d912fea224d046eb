"""Signed angle between two projected vectors, and its gradients: shared by the angle tasks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel
from ptnsbc_core.types import Array

SOFTENING_M2 = 0.05**2
"""Added to squared projected lengths: the gradient of an angle stays below 10 rad/m when points coincide."""


class SignedAngle(NamedTuple):
    """Angle from a to b and its gradients with respect to both."""

    angle: float  # [rad], (-pi, pi]
    d_a: Array  # (3,) [rad/m]
    d_b: Array  # (3,) [rad/m]


@kernel
def signed_angle(a: Array, b: Array, first: int, second: int) -> SignedAngle:
    """Angle from a to b (3,) projected on two axes: atan2(a x b, a . b) in place of (24).

    The gradients are those of the design's rule, (-Q0 a)^T/|a|^2 and (Q0 b)^T/|b|^2, softened where a
    projection vanishes (Table 2: UAV 2 and 3 share x and z).
    """
    angle = math.atan2(
        a[first] * b[second] - a[second] * b[first], a[first] * b[first] + a[second] * b[second]
    )
    d_a = np.zeros(3)
    d_b = np.zeros(3)
    length_a = a[first] * a[first] + a[second] * a[second]
    length_b = b[first] * b[first] + b[second] * b[second]
    soft_a = length_a + SOFTENING_M2 * math.exp(-length_a / SOFTENING_M2)
    soft_b = length_b + SOFTENING_M2 * math.exp(-length_b / SOFTENING_M2)
    d_a[first], d_a[second] = a[second] / soft_a, -a[first] / soft_a
    d_b[first], d_b[second] = -b[second] / soft_b, b[first] / soft_b
    return SignedAngle(angle, d_a, d_b)
