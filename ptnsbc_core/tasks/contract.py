"""The result of a task, for the behaviours and the composition."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.types import Array, Matrix3, Vector3

ZERO: Matrix3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Jacobian with respect to a point on which the task does not depend."""


class TaskGeometry(NamedTuple):
    """Value and Jacobians of a formation task for one set of own, parent and reference positions."""

    value: Vector3  # sigma; the task's own units, angles in [rad]
    own: Matrix3  # d sigma / d p_i
    parent: Matrix3  # d sigma / d p_j
    reference: Matrix3  # d sigma / d p_k
    periodic: Vector3  # 1 where the row is an angle, whose error is wrapped


class ClearanceTask(NamedTuple):
    """The clearance task at one tick: the task with the highest priority."""

    velocity: Vector3  # J^+ of the binding constraints [m/s]; zero without any
    jacobian: Array  # (A, 3) their normals
    secondary: Vector3  # velocity for the priority below: the formation's, with circulation added
    memory: Array  # obstacle memory after this tick
