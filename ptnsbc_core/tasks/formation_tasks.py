"""The formation tasks: one class each.

A task sigma (3,) is a function of three positions [m, ENU]: p_i of the UAV, p_j of its parent, and p_k of the
reference, the leader plus its anchor. A new task is a class here and a line in `table`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from ptnsbc_core.algebra import div3, eigen3, gram3, norm3, scale3, sub3, wrap_angle
from ptnsbc_core.kernel import formula, inline_kernel
from ptnsbc_core.tasks.table import CLASSES, TASKS
from ptnsbc_core.types import Array, Matrix3, Vector2, Vector3, Vector3Like

ZERO: Matrix3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Jacobian with respect to a point on which the task does not depend."""

SOFTENING_M2 = 0.05**2
"""Added to squared projected lengths: the gradient of an angle stays below 15 rad/m where points coincide."""

_LONG_M2 = 0.1
"""A squared length above which what is added, 0.05^2 exp(-40) at most, is below half a unit in its last place."""


class TaskGeometry(NamedTuple):
    """Value and Jacobians of a formation task for one set of own, parent and reference positions."""

    value: Vector3  # sigma; the task's own units, angles in [rad]
    own: Matrix3  # d sigma / d p_i
    parent: Matrix3  # d sigma / d p_j
    reference: Matrix3  # d sigma / d p_k
    periodic: Vector3  # 1 where the row is an angle, whose error is wrapped


class FormationTask(Protocol):
    """The contract of a formation task.

    Attributes:
        angles: Rows of sigma that are angles at the horizontal arm to the parent: times the arm they are metres.
    """

    angles: ClassVar[tuple[bool, bool, bool]]

    @staticmethod
    def evaluate(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
        """Value and Jacobians at positions (3,) [m, ENU]."""
        ...


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

    d_a = (a_y, -a_x) / |a|^2 and d_b = (-b_y, b_x) / |b|^2, with both squares softened where a projection vanishes
    (Table 2: UAV 2 and 3 share x and z).
    """
    angle = math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    length_a = a[0] * a[0] + a[1] * a[1]
    length_b = b[0] * b[0] + b[1] * b[1]
    soft_a, soft_b = softened(length_a), softened(length_b)
    return SignedAngle(angle, (a[1] / soft_a, -a[0] / soft_a), (-b[1] / soft_b, b[0] / soft_b))


class DistanceAngles:
    """Task `distance_angles`, (23): distance to the parent, angles parent-own-reference in XOY and XOZ.

    sigma = [|p_i - p_j|, angle from p_j - p_i to p_k - p_i in XOY, the same in XOZ]; world ENU, metres and radians,
    angles counted counter-clockwise from the parent to the reference. Jacobians replace (25)-(29), which divide
    by zero when the three are collinear. Singular when the angle at k is 90 degrees (docs/method.md).
    """

    angles = (False, True, True)

    @staticmethod
    @inline_kernel
    def evaluate(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
        """Value and Jacobians at positions (3,) [m, ENU]."""
        away = sub3(own, parent)
        distance = norm3(away)
        outwards = div3(away, max(distance, 1e-9))
        back, ahead = sub3(parent, own), sub3(reference, own)
        flat = signed_angle((back[0], back[1]), (ahead[0], ahead[1]))
        upright = signed_angle((back[0], back[2]), (ahead[0], ahead[2]))
        (fax, fay), (fbx, fby) = flat.d_a, flat.d_b
        (uax, uaz), (ubx, ubz) = upright.d_a, upright.d_b
        return TaskGeometry(
            (distance, flat.angle, upright.angle),
            (outwards, (-(fax + fbx), -(fay + fby), 0.0), (-(uax + ubx), 0.0, -(uaz + ubz))),
            (scale3(-1.0, outwards), (fax, fay, 0.0), (uax, 0.0, uaz)),
            ((0.0, 0.0, 0.0), (fbx, fby, 0.0), (ubx, 0.0, ubz)),
            (0.0, 1.0, 1.0),
        )


class ParentAngle:
    """Task `parent_angle`: distance to the parent, angle at the parent, height above the parent.

    sigma = [|p_i - p_j|, angle from p_k - p_j to p_i - p_j in XOY, z_i - z_j]; world ENU, metres and radians. The
    same rigidity as (23), and its smallest singular value is min(1, 1/rho) in a flat formation, rho the
    horizontal distance to the parent: it never vanishes where (23) does.
    """

    angles = (False, True, False)

    @staticmethod
    @inline_kernel
    def evaluate(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
        """Value and Jacobians at positions (3,) [m, ENU]."""
        away = sub3(own, parent)
        distance = norm3(away)
        outwards = div3(away, max(distance, 1e-9))
        ahead = sub3(reference, parent)
        at = signed_angle((ahead[0], ahead[1]), (away[0], away[1]))
        (ax, ay), (bx, by) = at.d_a, at.d_b
        return TaskGeometry(
            (distance, at.angle, away[2]),
            (outwards, (bx, by, 0.0), (0.0, 0.0, 1.0)),
            (scale3(-1.0, outwards), (-(ax + bx), -(ay + by), 0.0), (0.0, 0.0, -1.0)),
            ((0.0, 0.0, 0.0), (ax, ay, 0.0), (0.0, 0.0, 0.0)),
            (0.0, 1.0, 0.0),
        )


class RelativePosition:
    """Task `relative_position`: sigma = p_i - p_j [m, ENU], J = I. Never singular: the robust reference."""

    angles = (False, False, False)

    @staticmethod
    @formula
    def evaluate(own: Vector3Like, parent: Vector3Like, reference: Vector3Like) -> TaskGeometry:
        """Value and Jacobians at positions (3,) [m, ENU]; the reference is not used."""
        with_own = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        with_parent = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
        return TaskGeometry(sub3(own, parent), with_own, with_parent, ZERO, (0.0, 0.0, 0.0))


FORMATION_TASKS: dict[str, type[FormationTask]] = {
    name: globals()[class_name] for name, class_name in CLASSES.items()
}


def needs_arm(name: str) -> bool:
    """True if the task has no meaning for a place straight above or below the parent."""
    return any(FORMATION_TASKS[name].angles)


def metres_per_row(name: str, arm_m: float) -> Vector3:
    """Factors that put every row of a task in metres."""
    first, second, third = (arm_m if angle else 1.0 for angle in FORMATION_TASKS[name].angles)
    return first, second, third


_Evaluate = Callable[[int, Vector3Like, Vector3Like, Vector3Like], TaskGeometry]


def _either(number: int, law: Callable[..., TaskGeometry], others: _Evaluate) -> _Evaluate:
    """Choose a task by its number: a branch costs a kernel less than a table of functions."""

    @inline_kernel
    def evaluate(
        task: int, own: Vector3Like, parent: Vector3Like, reference: Vector3Like
    ) -> TaskGeometry:
        if task == number:
            return law(own, parent, reference)
        return others(task, own, parent, reference)

    return evaluate


def _only(law: Callable[..., TaskGeometry]) -> _Evaluate:
    @inline_kernel
    def evaluate(
        task: int, own: Vector3Like, parent: Vector3Like, reference: Vector3Like
    ) -> TaskGeometry:
        return law(own, parent, reference)

    return evaluate


def _chosen() -> _Evaluate:
    *names, last = FORMATION_TASKS
    chosen = _only(FORMATION_TASKS[last].evaluate)
    for name in reversed(names):
        chosen = _either(TASKS[name], FORMATION_TASKS[name].evaluate, chosen)
    return chosen


evaluate = _chosen()
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
    x, y, z = evaluate(task, own_offset, parent_offset, reference_offset).value
    return float(x), float(y), float(z)


def conditioning(
    task: int, own_offset: Array, parent_offset: Array, reference_offset: Array, row_scale: Vector3
) -> float:
    """Smallest singular value of the task's scaled Jacobian at the desired formation."""
    jacobian = np.array(evaluate(task, own_offset, parent_offset, reference_offset).own)
    smallest = float(np.min(eigen3(gram3(jacobian * np.array(row_scale).reshape(3, 1))).values))
    return float(np.sqrt(max(smallest, 0.0)))
