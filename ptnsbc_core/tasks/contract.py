"""What a formation task gives to the planner; composition knows nothing else of it."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.types import Array


class TaskGeometry(NamedTuple):
    """Value and Jacobians of one task at one configuration of own, parent and reference position."""

    value: Array  # (3,) sigma; the task's own units, angles in [rad]
    own: Array  # (3, 3) d sigma / d p_i
    parent: Array  # (3, 3) d sigma / d p_j
    reference: Array  # (3, 3) d sigma / d p_k
    periodic: Array  # (3,) 1 where the row is an angle, whose error is wrapped
