"""The motion of a neighbour: as its messages report it, as the own sensor sees it, and of several parents as of one.

A message carries the velocity that its sender commands, not the one that it measures: a measured velocity has
gone through the tilt, the motors and the filter of the sender, and a chain of UAVs that feed it forward amplifies
that lag at every hop.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import (
    add3,
    axpy,
    limit_norm,
    load3,
    matvec_transposed,
    norm3,
    scale3,
    store3,
    sub3,
)
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.kinematics import rotation, velocity_enu
from ptnsbc_core.tasks.signed_distance import TANGENT_RADIUS_M
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    NEVER_RECEIVED_S,
    AgentConfig,
    AgentInputs,
    Array,
    Estimate,
    NeighbourMotion,
    NeighbourMotions,
    OdometryLike,
    Vector3,
)

UNKNOWN = NeighbourMotion((0.0, 0.0, 0.0), -NEVER_RECEIVED_S, (0.0, 0.0, 0.0))
"""Nothing has been received."""

SILENT = NeighbourMotion((0.0, 0.0, 0.0), -1e6, (0.0, 0.0, 0.0))
"""Long ago: the next message counts as the first one after a silence, and begins no epoch."""

_SAME_S = 1e-6
"""Stamps that differ by less are those of one message."""

_RESPONSE_S = 0.25
"""A vehicle that follows its command deviates from it by no more than its largest acceleration in this time."""

_FULL, _NONE = 0.1, 0.5
"""Shares of stale_s: a parent whose message is older than the freshest by less than the first has all of its weight,
by more than the second none."""


class Neighbour(NamedTuple):
    """Motion of another UAV, extrapolated to the present from a message that came `delay_s` later than it could."""

    position: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s, ENU]
    acceleration: Vector3  # [m/s^2, ENU]
    delay_s: float  # [s]


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


@kernel
def associate(reported: Neighbour, near: Array, near_age_s: float, gate_m: float) -> Neighbour:
    """The near object that is a neighbour: the nearest one to its reported position; the report where there is none.

    Two UAVs that localise themselves by satellite have independent errors, and a formation built from two such
    positions is off by both. The sensor places an object relative to the UAV's own position, whose error is then in
    both ends of the difference and cancels. The same holds for velocities. This is not one of the paper's laws; in its
    experiment the UAVs detect each other by their own sensors.

    Args:
        reported: position and velocity that the neighbour reports, extrapolated to the present.
        near: (M, 8) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU] above [m].
        near_age_s: age of `near`, by which its objects are extrapolated.
        gate_m: an object at this distance or farther from the reported position is not the neighbour.
    """
    least, neighbour = gate_m, reported
    for row in range(near.shape[0]):
        if near[row, 3] >= TANGENT_RADIUS_M:
            continue  # it stands for a wall: its centre is nowhere
        velocity = load3(near[row], 4)
        position = axpy(near_age_s, velocity, near[row])
        distance = norm3(sub3(position, reported.position))
        if distance < least:
            least = distance
            neighbour = Neighbour(position, velocity, reported.acceleration, reported.delay_s)
    return neighbour


@inline_kernel
def parent_and_leader(
    inputs: AgentInputs,
    estimate: Estimate,
    motions: NeighbourMotions,
    clock: Clock,
    config: AgentConfig,
) -> tuple[Neighbour, Neighbour]:
    """The places of parent and leader now, for a follower that has received its parent's state."""
    parent = extrapolated(inputs.parent, motions.parent, inputs.parent_age_s, clock.dt)
    leader = Neighbour(estimate.position, estimate.velocity, motions.leader.acceleration, 0.0)
    if config.association_gate_m > 0.0:
        near, age_s = inputs.near, inputs.near_age_s
        parent = associate(parent, near, age_s, config.association_gate_m)
        leader = associate(leader, near, age_s, config.association_gate_m)
    return parent, leader


@kernel
def mean_parent(
    states: Array, ages: Array, weights: Array, shifts: Array, stale_s: float, mean: Array
) -> float:
    """Write the mean message of several parents, with world axes as body axes, and return its age [s].

    A parent gives its state, moved to the slot of the first parent. The mean of these is the message of one parent in
    that slot, and the laws take it as such (docs/notes/chains.md, "Several parents"). The weight of a parent that is
    not heard goes to the others. Without any message the age is NEVER_RECEIVED_S.

    Args:
        states: (P, 13) newest odometry vectors of the parents.
        ages: (P,) their ages [s].
        weights: (P,) of the parents, positive.
        shifts: (P, 3) [m, ENU] from the slot of each parent to that of the first.
        stale_s: silence after which a UAV without another parent holds.
        mean: (13,) is overwritten.
    """
    position, velocity, zero = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    age, total, freshest = 0.0, 0.0, NEVER_RECEIVED_S
    for k in range(len(ages)):
        freshest = min(freshest, ages[k])
    for k in range(len(ages)):
        late = (ages[k] - freshest) / stale_s
        weight = weights[k] * min(max((_NONE - late) / (_NONE - _FULL), 0.0), 1.0)
        position = axpy(weight, add3(load3(states[k], 0), load3(shifts[k], 0)), position)
        velocity = axpy(weight, velocity_enu(states[k]), velocity)
        age += weight * ages[k]
        total += weight
    store3(mean, 0, scale3(1.0 / total, position))
    store3(mean, 3, zero)
    mean[6] = 1.0
    store3(mean, 7, scale3(1.0 / total, velocity))
    store3(mean, 10, zero)
    return age / total if freshest < NEVER_RECEIVED_S else NEVER_RECEIVED_S
