"""The formation tasks by kind: chosen inside the compiled planner, so no task costs what another one needs."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import eigen3, gram3, minus, wrap
from ptnsbc_core.kernel import kernel
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.tasks.distance_angles import distance_angles
from ptnsbc_core.tasks.parent_angle import parent_angle
from ptnsbc_core.tasks.relative_position import relative_position
from ptnsbc_core.types import TASK_DISTANCE_ANGLES, TASK_PARENT_ANGLE, Array


@kernel
def evaluate(task: int, own: Array, parent: Array, reference: Array) -> TaskGeometry:
    """Value and Jacobians of the task of this kind at positions (3,) [m, ENU]."""
    if task == TASK_DISTANCE_ANGLES:
        return distance_angles(own, parent, reference)
    if task == TASK_PARENT_ANGLE:
        return parent_angle(own, parent, reference)
    return relative_position(own, parent, reference)


@kernel
def task_error(geometry: TaskGeometry, desired: Array) -> Array:
    """Signed error sigma_d - sigma (3,), angles wrapped; the printed absolute value diverges."""
    error = minus(desired, geometry.value)
    for i in range(3):
        if geometry.periodic[i] > 0.0:
            error[i] = wrap(error[i])
    return error


def desired_value(
    task: int, own_offset: Array, parent_offset: Array, reference_offset: Array
) -> Array:
    """Desired task value (3,) of a formation given as offsets from the leader [m, ENU]."""
    return evaluate(task, own_offset, parent_offset, reference_offset).value


def conditioning(
    task: int, own_offset: Array, parent_offset: Array, reference_offset: Array, row_scale: Array
) -> float:
    """Smallest singular value of the task's scaled Jacobian at the desired formation."""
    jacobian = evaluate(task, own_offset, parent_offset, reference_offset).own
    smallest = float(np.min(eigen3(gram3(jacobian * row_scale.reshape(3, 1))).values))
    return float(np.sqrt(max(smallest, 0.0)))
