"""A deadlock: a UAV wants to go to its place, and avoidance has long left it no way there.

A UAV stands still in a tick in which avoidance acts, the behaviour asks for WANTED or more towards the place, and the
command has less than NEAR_ZERO of it. The time that it stands still, less the time that it does not, counts. From
deadlock_s on it climbs to a layer of its own above its place, each UAV at another speed: those that block each other
by the same rule and from mirrored places leave the symmetry. No talking is needed, see docs/notes/clearance.md.
"""

from __future__ import annotations

from ptnsbc_core.algebra import add3, dot3, norm3, sub3
from ptnsbc_core.behaviours.contract import FormationPlace
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.types import ClearanceConfig, Vector3

WANTED, NEAR_ZERO = 0.1, 0.05
"""Speeds [m/s] towards the place, beside it."""

_LONGER = 1.25
"""The count ends at so many times deadlock_s: a UAV that can go on leaves the deadlock after the rest of it."""


_HOMING = 2.0
"""Gain [1/s] with which a UAV comes to its layer."""


@inline_kernel
def stands_still(wanted: Vector3, command: Vector3, place: FormationPlace) -> bool:
    """True if the command [m/s, ENU] goes hardly towards the place although the wanted velocity does."""
    distance = norm3(place.error)
    asked = dot3(sub3(wanted, place.velocity), place.error)
    left = dot3(sub3(command, place.velocity), place.error)
    return asked > WANTED * distance and left < NEAR_ZERO * distance


@inline_kernel
def standing_time(before_s: float, still: bool, dt: float, config: ClearanceConfig) -> float:
    """The time [s] that a UAV stands still, after a tick of `dt` [s]."""
    if still:
        return min(before_s + dt, _LONGER * config.deadlock_s)
    return max(before_s - dt, 0.0)


@inline_kernel
def in_deadlock(standing_s: float, config: ClearanceConfig) -> bool:
    """True if a UAV that has stood still for so long is in a deadlock."""
    return standing_s >= config.deadlock_s


@inline_kernel
def way_out(
    velocity: Vector3, place: FormationPlace, standing_s: float, config: ClearanceConfig
) -> Vector3:
    """The request of a UAV: a velocity [m/s, ENU], and in a deadlock the climb to its layer beside that."""
    if not in_deadlock(standing_s, config):
        return velocity
    below = config.climb * config.deadlock_s + place.error[2]  # [m] to the layer
    return add3(velocity, (0.0, 0.0, min(max(_HOMING * below, 0.0), config.climb)))
