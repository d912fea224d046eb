"""The way back after an encounter, and the way out of one that leaves none.

The way back is a time base of the UAV's own, armed when nothing keeps it from its plan any more. Let x be what the UAV
deviates from its plan by itself, and u the velocity with which it closes x at that instant. From then on it follows

    P(s) = (A + B e^(-kappa s)) (1 - h(s / T))        B = u / kappa, A = x - B

so that P(0) = x, P_dot(0) = -u and P = 0 from T on, whatever x and u are. T follows from A in closed form. Feedback
acts on x - P only. An encounter in between arms it anew, see docs/notes/way_back.md.

In a deadlock a UAV wants to go to its place, and avoidance has long left it no way there. It stands still in a tick in
which avoidance acts, the behaviour asks for WANTED or more towards the place, and the command has less than NEAR_ZERO
of it. The time that it stands still, less the time that it does not, counts. From deadlock_s on it climbs to a layer
of its own above its place, each UAV at another speed: those that block each other by the same rule and from mirrored
places leave the symmetry. No talking is needed, see docs/notes/clearance.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.algebra import add3, axpy, dot3, norm3, scale3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.timebase import Clock, feasible_deadline, h
from ptnsbc_core.types import ClearanceConfig, FormationPlace, Recovery, RecoveryConfig, Vector3

_ZERO = (0.0, 0.0, 0.0)

UNDISTURBED = Recovery(False, 0.0, 0.0, _ZERO, _ZERO)
"""Nothing has kept the UAV from its plan."""

DISTURBED = Recovery(True, 0.0, 0.0, _ZERO, _ZERO)
"""Something keeps the UAV from its plan."""

WANTED, NEAR_ZERO = 0.1, 0.05
"""Speeds [m/s] towards the place, beside it."""

_LONGER = 1.25
"""The count ends at so many times deadlock_s: a UAV that can go on leaves the deadlock after the rest of it."""

_HOMING = 2.0
"""Gain [1/s] with which a UAV comes to its layer."""


class WayBack(NamedTuple):
    """The way back at one tick; without one there is nothing left of it."""

    deviation: Vector3  # [m, ENU] P
    velocity: Vector3  # [m/s, ENU] -P_dot over the step
    acceleration: Vector3  # [m/s^2, ENU] its change to the next step
    progress: float  # h(s / T) [1]


@kernel
def recovery_duration(distance: float, config: RecoveryConfig) -> float:
    """T [s] for a distance [m]: what the limits of speed and acceleration need, and no less than `least_s`."""
    needed = feasible_deadline(distance, config.speed, config.acceleration)
    return max(config.least_s, needed)


@inline_kernel
def armed(
    deviation: Vector3, closing: Vector3, t: float, kappa: float, config: RecoveryConfig
) -> Recovery:
    """The time base from `t` [s] on, for a deviation (3,) [m] that closes at (3,) [m/s]."""
    moving = scale3(1.0 / max(kappa, 1e-9), closing)
    rest = sub3(deviation, moving)
    distance = max(norm3(rest), norm3(deviation))
    return Recovery(False, t, recovery_duration(distance, config), rest, moving)


@inline_kernel
def _at(recovery: Recovery, s: float, kappa: float) -> Vector3:
    left = 1.0 - h(s / recovery.duration_s)
    return axpy(left * math.exp(-kappa * s), recovery.moving, scale3(left, recovery.rest))


@inline_kernel
def way_back(recovery: Recovery, clock: Clock, kappa: float) -> WayBack:
    """The way back at this tick."""
    s = clock.t - recovery.t
    if s >= recovery.duration_s:
        return WayBack((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    now = _at(recovery, s, kappa)
    then = _at(recovery, s + clock.dt, kappa)
    after = _at(recovery, s + 2.0 * clock.dt, kappa)
    velocity = scale3(1.0 / clock.dt, sub3(now, then))
    later = scale3(1.0 / clock.dt, sub3(then, after))
    acceleration = scale3(1.0 / clock.dt, sub3(later, velocity))
    return WayBack(now, velocity, acceleration, h(s / recovery.duration_s))


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
