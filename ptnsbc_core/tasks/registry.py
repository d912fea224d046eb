"""The formation tasks by kind. The kernel chooses, so that no task costs the computation of another one."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import eigen3, gram3, sub3, wrap_angle
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.tasks.distance_angles import distance_angles
from ptnsbc_core.tasks.parent_angle import parent_angle
from ptnsbc_core.tasks.relative_position import relative_position
from ptnsbc_core.types import TASK_DISTANCE_ANGLES, TASK_PARENT_ANGLE, Array, Vector3, Vector3Like


@kernel
def evaluate(
    task: int, own: Vector3Like, parent: Vector3Like, reference: Vector3Like
) -> TaskGeometry:
    """Value and Jacobians of the task of this kind at positions (3,) [m, ENU]."""
    if task == TASK_DISTANCE_ANGLES:
        return distance_angles(own, parent, reference)
    if task == TASK_PARENT_ANGLE:
        return parent_angle(own, parent, reference)
    return relative_position(own, parent, reference)


@inline_kernel
def task_error(geometry: TaskGeometry, desired: Vector3) -> Vector3:
    """Signed error sigma_d - sigma, angles wrapped; the absolute value as printed diverges."""
    error, periodic = sub3(desired, geometry.value), geometry.periodic
    return (
        wrap_angle(error[0]) if periodic[0] > 0.0 else error[0],
        wrap_angle(error[1]) if periodic[1] > 0.0 else error[1],
        wrap_angle(error[2]) if periodic[2] > 0.0 else error[2],
    )


def desired_value(
    task: int, own_offset: Array, parent_offset: Array, reference_offset: Array
) -> Vector3:
    """Desired task value of a formation given as offsets from the leader [m, ENU]."""
    return evaluate(task, own_offset, parent_offset, reference_offset).value


def conditioning(
    task: int, own_offset: Array, parent_offset: Array, reference_offset: Array, row_scale: Vector3
) -> float:
    """Smallest singular value of the task's scaled Jacobian at the desired formation."""
    jacobian = np.array(evaluate(task, own_offset, parent_offset, reference_offset).own)
    smallest = float(np.min(eigen3(gram3(jacobian * np.array(row_scale).reshape(3, 1))).values))
    return float(np.sqrt(max(smallest, 0.0)))
