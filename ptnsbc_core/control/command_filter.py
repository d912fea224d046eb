"""Command filter: it turns a commanded velocity into a reference that the body can follow.

First order with limited acceleration. Its rate is the V_r_dot of (49), which would otherwise be impulsive
whenever a task is switched.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import axpy, norm3, scale3, sub3
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.types import Vector3


class FilterOutput(NamedTuple):
    """Reference after one step, its rate during the step, and whether the rate limit acted."""

    value: Vector3  # [m/s] or [rad/s]
    rate: Vector3  # [m/s^2] or [rad/s^2]
    saturated: bool


@inline_kernel
def filter_step(
    state: Vector3,
    target: Vector3,
    lead: Vector3,
    bandwidth: float,
    limit: float,
    dt: float,
) -> FilterOutput:
    """Move `state` (3,) towards `target` (3,) at `bandwidth` [1/s], by at most `limit` per second.

    `lead` (3,) is the rate of the target. A target that moves at a known rate is followed without the lag
    rate / bandwidth of the filter alone.
    """
    gain = min(bandwidth, 1.0 / dt)
    rate = axpy(gain, sub3(target, state), lead)
    length = norm3(rate)
    saturated = length > limit
    if saturated:
        rate = scale3(limit / length, rate)
    return FilterOutput(axpy(dt, rate, state), rate, saturated)
