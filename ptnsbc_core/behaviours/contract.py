"""Input and output of a behaviour."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.behaviours.recovery import UNDISTURBED
from ptnsbc_core.types import Recovery, StartErrors, Vector3


class Beside(NamedTuple):
    """The distance of a UAV from its plan by its own doing: without the part that it takes over from its parent."""

    deviation: Vector3  # [m, ENU] to the plan
    velocity: Vector3  # [m/s, ENU] of the plan: what the behaviour asks for without a deviation
    planned: bool  # an encounter is followed by a way back


class FormationPlace(NamedTuple):
    """The place of a UAV in the end."""

    error: Vector3  # [m, ENU] from the UAV to it
    velocity: Vector3  # [m/s, ENU] of it


class Behaviour(NamedTuple):
    """Velocity that one behaviour asks for, and the state of its task."""

    velocity: Vector3  # [m/s, ENU]
    error: Vector3  # sigma_d - sigma, the task's own units
    singular_value: float
    acceleration: (
        Vector3  # [m/s^2, ENU] rate of `velocity` while the plan is kept: the command filter's lead
    )
    slot_start: Vector3  # [m, ENU] start error that the plan of this epoch uses
    edge_start: Vector3  # [m, ENU] likewise, relative to the parent
    beside: Beside
    place: FormationPlace


class EpochErrors(NamedTuple):
    """Errors at the epoch, of which plans are made."""

    at_epoch: bool  # this tick is the epoch: the present errors count
    start: StartErrors
    recovery: Recovery = UNDISTURBED  # after the last encounter


class Neighbour(NamedTuple):
    """Motion of another UAV, extrapolated to the present from a message that came `delay_s` later than it could."""

    position: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s, ENU]
    acceleration: Vector3  # [m/s^2, ENU]
    delay_s: float  # [s]
