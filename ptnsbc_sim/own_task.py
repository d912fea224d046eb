"""Formation tasks of the user: a function of three points, differentiated by central differences."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.step import TaskPoints
from ptnsbc_core.tasks.contract import ZERO, TaskGeometry
from ptnsbc_core.types import Array, Matrix3, Vector3
from ptnsbc_sim.user_file import UserFileError, UserFunction, place_of, user_function

_STEP_M = 1e-5  # of the differences: rounding and truncation are both near 1e-11
_LEAST_SLOPE = 1e-6
_EXPECTED = "three numbers, the value of the task"
_ZERO: Vector3 = (0.0, 0.0, 0.0)


_ONES: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NO_TASK = TaskGeometry(_ZERO, _ONES, ZERO, ZERO, _ZERO)
"""Placeholder for a UAV that has not heard its parent: no step computes with it."""


class OwnTask:
    """A task sigma(own, parent, reference) of positions (3,) [m, ENU], with rows that may be angles."""

    def __init__(self, function: UserFunction) -> None:
        self._function = function
        angles = getattr(function.function, "angles", ())
        rows = set(angles) if isinstance(angles, tuple | list | set) else {-1}
        if not rows <= {0, 1, 2}:
            raise UserFileError(
                f"{place_of(function.function)}: angles = {angles!r}: expected the rows of the value that "
                "are angles, of 0, 1, 2"
            )
        self.periodic: Vector3 = (float(0 in rows), float(1 in rows), float(2 in rows))

    def value(self, own: Vector3, parent: Vector3, reference: Vector3) -> Vector3:
        """The value at these points.

        Raises:
            UserFileError: the function raised an error, or did not return three finite numbers.
        """
        call = self._function
        points = tuple(tuple(float(x) for x in point) for point in (own, parent, reference))
        at = f" at {points}"
        x, y, z = call.numbers(call(*points), 3, _EXPECTED, at)
        return x, y, z

    def geometry(self, own: Vector3, parent: Vector3, reference: Vector3) -> TaskGeometry:
        """Value and Jacobians at these points."""
        points = (own, parent, reference)
        slopes = [self._jacobian(points, which) for which in range(3)]
        return TaskGeometry(self.value(*points), slopes[0], slopes[1], slopes[2], self.periodic)

    def at(self, points: TaskPoints) -> TaskGeometry:
        """The geometry at the points of a step."""
        if not points.heard:
            return NO_TASK
        return self.geometry(points.own, points.parent, points.reference)

    def _jacobian(self, points: tuple[Vector3, Vector3, Vector3], which: int) -> Matrix3:
        columns = [self._column(points, which, axis) for axis in range(3)]
        a, b, c = ((columns[0][k], columns[1][k], columns[2][k]) for k in range(3))
        return a, b, c

    def _column(
        self, points: tuple[Vector3, Vector3, Vector3], which: int, axis: int
    ) -> list[float]:
        ends = []
        for step in (_STEP_M, -_STEP_M):
            moved = list(points[which])
            moved[axis] += step
            there = [*points]
            there[which] = (moved[0], moved[1], moved[2])
            ends.append(self.value(there[0], there[1], there[2]))
        return [
            (wrap_angle(high - low) if periodic else high - low) / (2.0 * _STEP_M)
            for high, low, periodic in zip(*ends, self.periodic, strict=True)
        ]

    def desired(self, own: Array, parent: Array, reference: Array) -> tuple[Vector3, Vector3]:
        """Desired value of a formation given as offsets (3,) [m, ENU], and the scale that puts each row in metres.

        Raises:
            UserFileError: a row does not depend on the UAV's own position.
        """
        x, y, z = (three_of(point) for point in (own, parent, reference))
        found = self.geometry(x, y, z)
        slopes = [math.hypot(*row) for row in found.own]
        if min(slopes) < _LEAST_SLOPE or np.linalg.matrix_rank(np.array(found.own), 1e-6) < 3:
            raise UserFileError(
                f"{place_of(self._function.function)}: at the desired formation own {x}, parent {y}, reference "
                f"{z} the derivatives by the own position are {found.own}: expected three independent rows"
            )
        return found.value, (1.0 / slopes[0], 1.0 / slopes[1], 1.0 / slopes[2])


def three_of(point: Array) -> Vector3:
    """A point as a tuple of floats."""
    x, y, z = (float(number) for number in point)
    return x, y, z


@lru_cache(maxsize=16)
def load_task(named: str) -> OwnTask:
    """Load the task that FILE.py:NAME names, which executes its file.

    Raises:
        UserFileError: there is no such file or function, or the file raises an error.
    """
    return OwnTask(user_function(named, "task", (_ZERO, _ZERO, _ZERO)))
