"""What goes into a behaviour and what comes out of it."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.types import Vector3


class Behaviour(NamedTuple):
    """Velocity that one behaviour asks for, and the state of its task."""

    velocity: Vector3  # [m/s, ENU]
    error: Vector3  # sigma_d - sigma, the task's own units
    singular_value: float


class EpochErrors(NamedTuple):
    """Errors at the epoch: the profile `reference` plans their decay."""

    at_epoch: bool  # this tick is the epoch: the present errors count
    task: Vector3
    attitude: Vector3  # [rad]


class Neighbour(NamedTuple):
    """Position and velocity of another UAV, extrapolated to the present."""

    position: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s, ENU]
