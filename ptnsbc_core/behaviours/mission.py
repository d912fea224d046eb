"""Motion beside the formation law: lead along the trajectory, keep the attitude, hold, or land.

The paper does not give these laws.
"""

from __future__ import annotations

from ptnsbc_core.algebra import add3, axpy, limit_norm, load3, norm3, scale3, sub3, wrap_angle
from ptnsbc_core.behaviours.formation import braked
from ptnsbc_core.behaviours.recovery import way_back
from ptnsbc_core.curves.trajectory import Reference, reference
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.kinematics import body_rates, euler_from_rotation, rotation, yaw_of
from ptnsbc_core.timebase import Clock, loop_gain, soft_start, task_acceleration, task_rate
from ptnsbc_core.types import (
    APPROACH_PLANNED,
    MODE_FORMATION,
    MODE_LAND,
    AgentConfig,
    AgentInputs,
    AgentState,
    Behaviour,
    Beside,
    EpochErrors,
    Estimate,
    FormationPlace,
    OdometryLike,
    PoseTarget,
    Vector3,
)


@kernel
def leader_tracking(
    position: Vector3, desired: Reference, epoch: EpochErrors, clock: Clock, config: AgentConfig
) -> Behaviour:
    """p_dot = c p_r_dot + G (p_r - p_1): sigma = p_1, J = I.

    The trajectory may already move at t = 0. c(t) keeps its feed-forward from being a step. The error that c(t)
    leaves decays by tf, because the gain acts until then.
    """
    error = sub3(desired.position, position)
    start_error = error if epoch.at_epoch else epoch.start.task
    gain = config.formation
    onset = soft_start(gain, clock)
    back = way_back(epoch.recovery, clock, gain.scale * gain.kappa)
    beside = sub3(error, back.deviation)
    closing = task_rate(gain, beside, start_error, clock)
    over = clock.t >= gain.duration_s
    if over:  # only avoidance leads it away from its trajectory after tf
        closing = braked(closing, (0.0, 0.0, 0.0), norm3(beside), loop_gain(gain, clock), config)
    free = scale3(onset, desired.velocity)
    velocity = add3(axpy(onset, desired.velocity, closing), back.velocity)
    # The error grows by what c(t) leaves of the feed-forward, and G acts on that too.
    later = Clock(clock.t + clock.dt, clock.start_t + clock.dt, clock.dt)
    onset_after = soft_start(gain, later)
    on_velocity = loop_gain(gain, later) * (1.0 - onset) + (onset_after - onset) / clock.dt
    acceleration = add3(task_acceleration(gain, beside, start_error, clock), back.acceleration)
    acceleration = axpy(on_velocity, desired.velocity, acceleration)
    acceleration = axpy(onset_after, desired.acceleration, acceleration)
    planned = over and config.approach == APPROACH_PLANNED
    return Behaviour(
        velocity,
        error,
        1.0,
        acceleration,
        error,
        error,
        Beside(error, free, planned),
        FormationPlace(error, desired.velocity),
    )


@kernel
def attitude(
    own: OdometryLike, yaw: float, epoch: EpochErrors, clock: Clock, config: AgentConfig
) -> tuple[Vector3, Vector3]:
    """w = W^-1 G (beta_d - beta) with beta_d = (0, 0, yaw).

    Returns the body rates [rad/s] and the Euler error [rad].
    """
    euler = euler_from_rotation(rotation(own, 3))
    error = (-euler[0], -euler[1], wrap_angle(yaw - euler[2]))
    start_error = error if epoch.at_epoch else epoch.start.attitude
    rate = task_rate(config.attitude, error, start_error, clock)
    return body_rates(euler, rate), error


@inline_kernel
def link_lost(inputs: AgentInputs, start_t: float, config: AgentConfig) -> bool:
    """True if the parent or a leader link has been silent for longer than stale_s.

    A link on which nothing was ever received counts as lost from stale_s after the first epoch.
    """
    if config.leader or start_t < config.stale_s:
        return False
    if inputs.parent_age_s > config.stale_s:
        return True
    return config.estimator.pinned and inputs.leader_age_s > config.stale_s


@inline_kernel
def hold_target(state: AgentState, inputs: AgentInputs, holding: bool) -> PoseTarget:
    """Pose to hold: that of the UAV when holding began."""
    if holding and state.mode == MODE_FORMATION:
        return PoseTarget(load3(inputs.own, 0), yaw_of(inputs.own))
    return state.hold


@inline_kernel
def hold_velocity(position: Vector3, target: Vector3, config: AgentConfig) -> Vector3:
    """v = k (p_hold - p), |v| at most half of the speed limit  (3,) [m/s, ENU]."""
    return limit_norm(
        scale3(config.hold_gain, sub3(target, position)), 0.5 * config.filter.max_speed
    )


@inline_kernel
def hold_behaviour(
    behaviour: Behaviour, inputs: AgentInputs, target: PoseTarget, config: AgentConfig
) -> Behaviour:
    """The mission behaviour with its velocity replaced by holding a position, or by descending over it."""
    velocity = hold_velocity(load3(inputs.own, 0), target.position, config)
    if inputs.mode == MODE_LAND:
        velocity = (velocity[0], velocity[1], -config.land_speed)
    return with_velocity(behaviour, velocity)


@formula
def with_velocity(behaviour: Behaviour, velocity: Vector3) -> Behaviour:
    """The behaviour with another velocity [m/s, ENU]; error and singular value stay for diagnostics."""
    return Behaviour(
        velocity,
        behaviour.error,
        behaviour.singular_value,
        (0.0, 0.0, 0.0),
        behaviour.slot_start,
        behaviour.edge_start,
        behaviour.beside,
        behaviour.place,
    )


@inline_kernel
def desired_yaw(
    estimate: Estimate, target: PoseTarget, holding: bool, clock: Clock, config: AgentConfig
) -> float:
    """Desired heading [rad]: of the pose held, of the trajectory (leader), or of the leader (follower)."""
    if holding:
        return target.yaw
    if config.leader:
        return reference(config.trajectory, clock.start_t).yaw
    return estimate.yaw
