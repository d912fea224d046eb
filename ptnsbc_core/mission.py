"""What one UAV is to do at this tick: follow the trajectory, keep its place in the formation, hold, or land."""

from __future__ import annotations

from ptnsbc_core.algebra import moved, three
from ptnsbc_core.kernel import leaf
from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_core.planner import Behaviour, EpochErrors, Neighbour, formation, hold, leader_tracking
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
    Estimate,
    PoseTarget,
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
    inputs: AgentInputs, estimate: Estimate, armed: EpochErrors, clock: Clock, config: AgentConfig
) -> Behaviour:
    """The mission behaviour: leader tracking for the leader, formation for a follower that has heard."""
    position = three(inputs.own, 0)
    if config.leader:
        desired = reference(config.trajectory, clock.start_t)
        return leader_tracking(position, desired, armed, clock, config)
    if inputs.parent_age_s >= NEVER_HEARD_S:
        rest = Reference(position, (0.0, 0.0, 0.0), 0.0)
        return leader_tracking(position, rest, armed, clock, config)
    velocity = velocity_enu(inputs.parent)
    parent = Neighbour(moved(inputs.parent, inputs.parent_age_s, velocity), velocity)
    leader = Neighbour(estimate.position, estimate.velocity)
    if config.sight_m > 0.0:
        near, age_s = inputs.near, inputs.near_age_s
        parent = sighted(parent, near, age_s, config.sight_m)
        leader = sighted(leader, near, age_s, config.sight_m)
    return formation(position, parent, leader, armed, clock, config)


@leaf
def hold_place(state: AgentState, inputs: AgentInputs, holding: bool) -> PoseTarget:
    """Where to hold: where the UAV was when holding began."""
    if holding and state.mode == MODE_FORMATION:
        return PoseTarget(three(inputs.own, 0), yaw_of(inputs.own))
    return state.hold


@leaf
def held(
    behaviour: Behaviour, inputs: AgentInputs, place: PoseTarget, config: AgentConfig
) -> Behaviour:
    """The mission behaviour replaced by keeping a place, or by descending over it."""
    velocity = hold(three(inputs.own, 0), place.position, config)
    if inputs.mode == MODE_LAND:
        velocity = (velocity[0], velocity[1], -config.land_speed)
    return Behaviour(velocity, behaviour.error, behaviour.singular_value)


@leaf
def desired_yaw(
    estimate: Estimate, place: PoseTarget, holding: bool, clock: Clock, config: AgentConfig
) -> float:
    """Heading to keep [rad]: of the place held, of the trajectory (leader), or of the leader (follower)."""
    if holding:
        return place.yaw
    if config.leader:
        return reference(config.trajectory, clock.start_t).yaw
    return estimate.yaw
