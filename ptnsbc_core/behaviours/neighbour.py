"""The motion of a neighbour, as its messages report it.

A message carries the velocity that its sender commands, not the one that it measures: a measured velocity has
gone through the tilt, the motors and the filter of the sender, and a chain of UAVs that feed it forward amplifies
that lag at every hop.
"""

from __future__ import annotations

from ptnsbc_core.algebra import axpy, limit_norm, matvec_transposed, norm3, scale3, sub3
from ptnsbc_core.behaviours.contract import Neighbour
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.kinematics import rotation, velocity_enu
from ptnsbc_core.types import NEVER_RECEIVED_S, NeighbourMotion, OdometryLike, Vector3

UNKNOWN = NeighbourMotion((0.0, 0.0, 0.0), -NEVER_RECEIVED_S, (0.0, 0.0, 0.0))
"""Nothing has been received."""

SILENT = NeighbourMotion((0.0, 0.0, 0.0), -1e6, (0.0, 0.0, 0.0))
"""Long ago: the next message counts as the first one after a silence, and begins no epoch."""

_SAME_S = 1e-6
"""Stamps that differ by less are those of one message."""

_RESPONSE_S = 0.25
"""A vehicle that follows its command deviates from it by no more than its largest acceleration in this time."""


@inline_kernel
def neighbour_motion(
    before: NeighbourMotion,
    state: OdometryLike,
    age_s: float,
    start_t: float,
    stale_s: float,
    max_acceleration: float,
) -> NeighbourMotion:
    """The motion after a tick at which the newest message (13,) is `age_s` old, `start_t` after the first epoch.

    The acceleration is the change of the commanded velocity between two messages. It is zero after the first one,
    after a silence of `stale_s`, and when a first epoch has started the time anew.
    """
    if age_s >= NEVER_RECEIVED_S:
        return before
    time = start_t - age_s
    gap = time - before.time
    if abs(gap) < _SAME_S:
        return before
    velocity = velocity_enu(state)
    if gap < 0.0 or gap > stale_s:
        return NeighbourMotion(velocity, time, (0.0, 0.0, 0.0))
    acceleration = scale3(1.0 / gap, sub3(velocity, before.velocity))
    return NeighbourMotion(velocity, time, limit_norm(acceleration, max_acceleration))


@inline_kernel
def extrapolated(
    state: OdometryLike, motion: NeighbourMotion, age_s: float, dt: float
) -> Neighbour:
    """The neighbour now, from its newest message (13,): the commanded velocity is that of `dt` after the stamp."""
    since = age_s - dt
    position = axpy(age_s, motion.velocity, (state[0], state[1], state[2]))
    position = axpy(age_s * (0.5 * age_s - dt), motion.acceleration, position)
    velocity = axpy(since, motion.acceleration, motion.velocity)
    return Neighbour(position, velocity, motion.acceleration, max(since, 0.0))


@inline_kernel
def reported_velocity(own: OdometryLike, command: Vector3, max_acceleration: float) -> Vector3:
    """Velocity [m/s, body FLU] to tell the neighbours: the command, within reach of the measured velocity.

    A vehicle that does not do what it is told, because it is saturated or failing, reports its measured velocity
    moved towards the command by what a healthy vehicle may lag.
    """
    measured = velocity_enu(own)
    ahead = sub3(command, measured)
    length, reach = norm3(ahead), _RESPONSE_S * max_acceleration
    share = 1.0 if length <= reach else reach / length
    return matvec_transposed(rotation(own, 3), axpy(share, ahead, measured))
