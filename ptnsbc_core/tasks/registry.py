"""The formation tasks by number. The kernel chooses, so that no task costs the computation of another one."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, cast

import numpy as np

from ptnsbc_core.algebra import eigen3, gram3, sub3, wrap_angle
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import Array, Vector3, Vector3Like

_Evaluate = Callable[[int, Vector3Like, Vector3Like, Vector3Like], TaskGeometry]


def _evaluate() -> _Evaluate:
    """A chain of comparisons, written from the table: numba has no table of functions that costs as little."""
    laws = {name: getattr(import_module(f"ptnsbc_core.tasks.{name}"), name) for name in TASKS}
    points = "own, parent, reference"
    *chosen, last = TASKS
    lines = [
        f"def evaluate(task, {points}):",
        *(f"    if task == {TASKS[name]}: return {name}({points})" for name in chosen),
        f"    return {last}({points})",
    ]
    scope: dict[str, Any] = {"__name__": __name__, **laws}
    exec(compile("\n".join(lines), __file__, "exec"), scope)
    return cast(_Evaluate, kernel(scope["evaluate"]))


evaluate = _evaluate()
"""Value and Jacobians of the task of this number at positions (3,) of own UAV, parent and reference [m, ENU]."""


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
