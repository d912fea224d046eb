"""What a formation task gives to the planner; composition knows nothing else of it."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.types import Matrix3, Vector3

FIXED: Matrix3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Jacobian of a point that takes no part."""


class TaskGeometry(NamedTuple):
    """Value and Jacobians of one task at one configuration of own, parent and reference position."""

    value: Vector3  # sigma; the task's own units, angles in [rad]
    own: Matrix3  # d sigma / d p_i
    parent: Matrix3  # d sigma / d p_j
    reference: Matrix3  # d sigma / d p_k
    periodic: Vector3  # 1 where the row is an angle, whose error is wrapped
