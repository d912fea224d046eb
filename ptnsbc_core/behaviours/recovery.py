"""The way back after an encounter: a time base of the UAV's own, armed when nothing keeps it from its plan any more.

Let x be what the UAV deviates from its plan by itself, and u the velocity with which it closes x at that instant. From
then on it follows

    P(s) = (A + B e^(-kappa s)) (1 - h(s / T))        B = u / kappa, A = x - B

so that P(0) = x, P_dot(0) = -u and P = 0 from T on, whatever x and u are. T follows from A in closed form. Feedback
acts on x - P only. An encounter in between arms it anew, see docs/notes/way_back.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.algebra import axpy, norm3, scale3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.timebase import Clock, feasible_deadline, h
from ptnsbc_core.types import Recovery, RecoveryConfig, Vector3

_ZERO = (0.0, 0.0, 0.0)

UNDISTURBED = Recovery(False, 0.0, 0.0, _ZERO, _ZERO)
"""Nothing has kept the UAV from its plan."""

DISTURBED = Recovery(True, 0.0, 0.0, _ZERO, _ZERO)
"""Something keeps the UAV from its plan."""


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
