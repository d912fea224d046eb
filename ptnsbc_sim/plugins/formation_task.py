"""A formation task that is plugged in: a function of three points, differentiated by central differences."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import cast

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.step import TaskPoints
from ptnsbc_core.tasks.formation_tasks import ZERO, TaskGeometry
from ptnsbc_core.types import Array, Matrix3, Vector3
from ptnsbc_sim.plugins.loader import Plugin, PluginError, load_plugin, place_of

_STEP_M = 1e-5  # of the differences: rounding and truncation are both near 1e-11
_LEAST_SLOPE = 1e-6

_ZERO: Vector3 = (0.0, 0.0, 0.0)
_ONES: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NO_TASK = TaskGeometry(_ZERO, _ONES, ZERO, ZERO, _ZERO)
"""Placeholder for a UAV that has not heard its parent: no step computes with it."""


class PluginTask:
    """A task sigma(own, parent, reference) of positions (3,) [m, ENU], with rows that may be angles."""

    def __init__(self, plugin: Plugin) -> None:
        self._plugin = plugin
        angles = getattr(plugin.function, "angles", ())
        rows = set(angles) if isinstance(angles, tuple | list | set) else {-1}
        if not rows <= {0, 1, 2}:
            raise PluginError(
                f"{place_of(plugin.function)}: angles = {angles!r}: expected the rows of the value that "
                "are angles, of 0, 1, 2"
            )
        self.periodic: Vector3 = (float(0 in rows), float(1 in rows), float(2 in rows))

    def geometry(self, own: Vector3, parent: Vector3, reference: Vector3) -> TaskGeometry:
        """Value and Jacobians at these points; PluginError as of `Plugin.numbers`."""
        points = (own, parent, reference)
        slopes = [self._jacobian(points, which) for which in range(3)]
        return TaskGeometry(self._value(points), slopes[0], slopes[1], slopes[2], self.periodic)

    def at(self, points: TaskPoints) -> TaskGeometry:
        """The geometry at the points of a step."""
        if not points.heard:
            return NO_TASK
        return self.geometry(points.own, points.parent, points.reference)

    def _value(self, points: tuple[Vector3, ...]) -> Vector3:
        return cast(Vector3, self._plugin.numbers(*points, at=str(points)))

    def _jacobian(self, points: tuple[Vector3, Vector3, Vector3], which: int) -> Matrix3:
        """(f(x + h) - f(x - h)) / 2h by every axis of one of the points."""
        columns = []
        for axis in range(3):
            ends = []
            for step in (_STEP_M, -_STEP_M):
                moved = [*points[which]]
                moved[axis] += step
                x, y, z = moved
                ends.append(self._value((*points[:which], (x, y, z), *points[which + 1 :])))
            columns.append(
                [
                    (wrap_angle(high - low) if periodic else high - low) / (2.0 * _STEP_M)
                    for high, low, periodic in zip(*ends, self.periodic, strict=True)
                ]
            )
        a, b, c = zip(*columns, strict=True)
        return a, b, c

    def desired(self, own: Array, parent: Array, reference: Array) -> tuple[Vector3, Vector3]:
        """Desired value of a formation given as offsets (3,) [m, ENU], and the scale that puts each row in metres.

        Raises:
            PluginError: a row does not depend on the UAV's own position.
        """
        x, y, z = (cast(Vector3, tuple(map(float, point))) for point in (own, parent, reference))
        task = self.geometry(x, y, z)
        slopes = [math.hypot(*row) for row in task.own]
        if min(slopes) < _LEAST_SLOPE or np.linalg.matrix_rank(np.array(task.own), 1e-6) < 3:
            raise PluginError(
                f"{place_of(self._plugin.function)}: at the desired formation own {x}, parent {y}, reference "
                f"{z} the derivatives by the own position are {task.own}: expected three independent rows"
            )
        return task.value, (1.0 / slopes[0], 1.0 / slopes[1], 1.0 / slopes[2])


@lru_cache(maxsize=16)
def load_task(named: str) -> PluginTask:
    """The task that FILE.py:NAME names; errors as of `load_plugin`."""
    return PluginTask(load_plugin("task", named))
