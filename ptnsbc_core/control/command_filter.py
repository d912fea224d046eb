"""Command filter, equations.md section 6: a commanded velocity becomes a reference the body can follow.

First order with limited acceleration; its rate is the V_r_dot of (49), which would otherwise be impulsive
whenever a task is switched.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import minus, moved, norm3, scaled
from ptnsbc_core.kernel import leaf
from ptnsbc_core.types import Vector3


class Filtered(NamedTuple):
    """Reference after one step, its rate during the step, and whether a limit cut it."""

    value: Vector3  # [m/s] or [rad/s]
    rate: Vector3  # [m/s^2] or [rad/s^2]
    saturated: bool


@leaf
def filter_step(
    state: Vector3, target: Vector3, bandwidth: float, limit: float, dt: float
) -> Filtered:
    """Move `state` (3,) towards `target` (3,) at `bandwidth` [1/s], by at most `limit` per second."""
    gain = min(bandwidth, 1.0 / dt)
    rate = scaled(gain, minus(target, state))
    length = norm3(rate)
    saturated = length > limit
    if saturated:
        rate = scaled(limit / length, rate)
    return Filtered(moved(state, dt, rate), rate, saturated)
