"""What one UAV is to do at this tick: follow the trajectory, keep its place in the formation, hold, or land."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import moved, part, put
from ptnsbc_core.kernel import leaf
from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_core.planner import Armed, Behaviour, Neighbour, formation, hold, leader_tracking
from ptnsbc_core.sighting import sighted
from ptnsbc_core.timebase import Clock
from ptnsbc_core.trajectory import Reference, reference
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_LAND,
    NEVER_HEARD_S,
    AgentConfig,
    AgentInputs,
    AgentState,
    Array,
)


@leaf
def lost(inputs: AgentInputs, start_t: float, config: AgentConfig) -> bool:
    """Whether the parent or a leader link has been silent for too long (never heard counts after stale_s)."""
    if config.leader or start_t < config.stale_s:
        return False
    if inputs.parent_age_s > config.stale_s:
        return True
    return config.estimator.pinned and inputs.leader_age_s > config.stale_s


@leaf
def behaviour_of_mission(
    inputs: AgentInputs, estimate: Array, armed: Armed, clock: Clock, config: AgentConfig
) -> Behaviour:
    """The mission behaviour: leader tracking for the leader, formation for a follower that has heard."""
    position = part(inputs.own, 0, 3)
    if config.leader:
        desired = reference(config.trajectory, clock.start_t)
        return leader_tracking(position, desired, armed, clock, config)
    if inputs.parent_age_s >= NEVER_HEARD_S:
        rest = Reference(position, np.zeros(3), 0.0)
        return leader_tracking(position, rest, armed, clock, config)
    velocity = velocity_enu(inputs.parent)
    parent = Neighbour(moved(inputs.parent, inputs.parent_age_s, velocity), velocity)
    leader = Neighbour(part(estimate, 0, 3), part(estimate, 3, 3))
    if config.sight_m > 0.0:
        near, age_s = inputs.near, inputs.near_age_s
        parent = sighted(parent, near, age_s, config.sight_m)
        leader = sighted(leader, near, age_s, config.sight_m)
    return formation(position, parent, leader, armed, clock, config)


@leaf
def hold_place(state: AgentState, inputs: AgentInputs, holding: bool) -> Array:
    """Where to hold (4,): where the UAV was when holding began."""
    if holding and state.mode == MODE_FORMATION:
        place = np.empty(4)
        put(place, 0, inputs.own[0:3])
        place[3] = yaw_of(inputs.own)
        return place
    return state.hold.copy()


@leaf
def held(behaviour: Behaviour, inputs: AgentInputs, place: Array, config: AgentConfig) -> Behaviour:
    """The mission behaviour replaced by keeping a place, or by descending over it."""
    velocity = hold(part(inputs.own, 0, 3), place, config)
    if inputs.mode == MODE_LAND:
        velocity[2] = -config.land_speed
    jacobian = np.zeros((3, 3))
    for i in range(3):
        jacobian[i, i] = 1.0
    return Behaviour(velocity, jacobian, behaviour.error, behaviour.singular_value)


@leaf
def desired_yaw(
    estimate: Array, place: Array, holding: bool, clock: Clock, config: AgentConfig
) -> float:
    """Heading to keep [rad]: of the place held, of the trajectory (leader), or of the leader (follower)."""
    if holding:
        return float(place[3])
    if config.leader:
        return reference(config.trajectory, clock.start_t).yaw
    return float(estimate[6])
