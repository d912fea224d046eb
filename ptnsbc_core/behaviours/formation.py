"""Behaviour of a follower: the formation law.

Two ways to the formation. `task` is the paper's: the task itself closes every error. `planned` forms by positions
and holds by the task: all UAVs move on straight lines, or on arcs that all turn by the same angle, with one time
profile, in the leader's moving frame. Feedback acts on deviations from that plan only (docs/method.md,
"Formation").
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import add3, axpy, hadamard3, matvec, norm3, scale3, sub3
from ptnsbc_core.behaviours.neighbour import Neighbour
from ptnsbc_core.behaviours.recovery import way_back
from ptnsbc_core.curves.shape import PlaceMotion, places_from_rest
from ptnsbc_core.curves.turned import plus_scaled, start_of, turned_step
from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.nullspace import TaskVelocity, damped_solve
from ptnsbc_core.tasks.formation_tasks import TaskGeometry, evaluate, task_error
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.timebase import (
    Clock,
    fallback_gain,
    h,
    homing_speed,
    plan_duration,
    step_gain,
    task_rate,
)
from ptnsbc_core.types import (
    APPROACH_PLANNED,
    SPEED_BRAKING,
    AgentConfig,
    Behaviour,
    Beside,
    EpochErrors,
    FormationPlace,
    Vector3,
)

_RELATIVE_POSITION = TASKS["relative_position"]
"""The task whose errors are the positions' own."""

_NEAR, _FAR = 0.1, 0.3
"""Shares of the parent's distance: a position error below the first is the task's, above the second it is not."""

_SINGULAR, _CONDITIONED = 0.5, 0.9
"""Smallest singular values [1] of the task in metres: below the first the positions hold, above the second the task."""

_HANDOVER = 0.2
"""The task takes over from the positions during this share of tf after tf."""

_SHARE = 0.5
"""rho: share of the parent's deviation from its plan that a child takes over; the rest is held beside the leader."""

HOMING = 0.5
"""Share of the vehicle's deceleration that the way back to a plan may use."""

_LEAST_LEFT = 0.1
"""A plan is not begun when less than this share of it is left."""


@inline_kernel
def is_plan_left(t: float, config: AgentConfig) -> bool:
    """True if a UAV whose epoch is at `t` [s] can still join the common plan."""
    return 1.0 - h(t / plan_duration(config.formation)) > _LEAST_LEFT


class FormationErrors(NamedTuple):
    """The errors of a follower in the formation."""

    task: Vector3  # sigma_d - sigma, the task's own units
    slot: Vector3  # E [m, ENU]: to the desired position relative to the leader
    edge: Vector3  # e [m, ENU]: to the desired position relative to the parent


@inline_kernel
def place_beside_leader(config: AgentConfig, start_t: float) -> PlaceMotion:
    """The place of a UAV beside the leader as it is flown, `start_t` [s] after the first epoch."""
    if config.shape.moving:
        duration = plan_duration(config.formation)
        return places_from_rest(config.shape, config.trajectory, duration, start_t).own
    return PlaceMotion(config.slot, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@kernel
def formation(
    position: Vector3,
    parent: Neighbour,
    leader: Neighbour,
    epoch: EpochErrors,
    clock: Clock,
    config: AgentConfig,
    user_task: TaskGeometry | None,
) -> Behaviour:
    """Velocity of a follower for its formation task; the reference k of the task is the leader plus the anchor.

    `user_task` is the task of the user where there is one, evaluated at the same positions.
    """
    if user_task is None:
        reference = add3(leader.position, config.anchor)
        geometry = evaluate(config.task, position, parent.position, reference)
    else:
        geometry = user_task
    slot, offset, desired = config.slot, config.offset, config.desired
    if config.shape.moving:
        duration = plan_duration(config.formation)
        at = places_from_rest(config.shape, config.trajectory, duration, clock.start_t)
        own = at.own
        edge = PlaceMotion(
            sub3(own.position, at.parent.position),
            sub3(own.velocity, at.parent.velocity),
            sub3(own.acceleration, at.parent.acceleration),
        )
        slot, offset, desired = own.position, edge.position, edge.position
        leader, parent = _moved(leader, own), _moved(parent, edge)
    errors = FormationErrors(
        task_error(geometry, desired),
        sub3(add3(leader.position, slot), position),
        sub3(offset, sub3(position, parent.position)),
    )
    if config.approach == APPROACH_PLANNED:
        return _planned(errors, geometry, parent, leader, epoch, clock, config)
    return _by_task(errors, geometry, parent, leader, epoch, clock, config)


@formula
def _moved(other: Neighbour, place: PlaceMotion) -> Neighbour:
    """The neighbour with the motion of the place beside it: what a place that stands still would have to follow."""
    return Neighbour(
        other.position,
        add3(other.velocity, place.velocity),
        add3(other.acceleration, place.acceleration),
        other.delay_s,
    )


@inline_kernel
def _solve(
    geometry: TaskGeometry, rate: Vector3, fallback: Vector3, config: AgentConfig
) -> TaskVelocity:
    """Velocity (3,) for a task rate; `fallback` in the directions that the task cannot steer.

    Task (23) can be close to singular: UAV 4 starts so in Table 2.
    """
    scale, own = config.row_scale, geometry.own
    jacobian = (scale3(scale[0], own[0]), scale3(scale[1], own[1]), scale3(scale[2], own[2]))
    return damped_solve(
        jacobian, hadamard3(scale, rate), fallback, config.damping_threshold, config.damping_max
    )


@kernel
def _by_task(
    errors: FormationErrors,
    geometry: TaskGeometry,
    parent: Neighbour,
    leader: Neighbour,
    epoch: EpochErrors,
    clock: Clock,
    config: AgentConfig,
) -> Behaviour:
    """v_i = v_L + J^+ [G (sigma_d - sigma) - J_j (v_j - v_L)], in place of (30)  (3,) [m/s, ENU].

    The reference moves with v_L, so its own term vanishes. v_L stays outside the pseudo-inverse: damping must not
    slow the feed-forward.
    """
    gain = config.formation
    start_error = errors.task if epoch.at_epoch else epoch.start.task
    relative = sub3(parent.velocity, leader.velocity)
    rate = task_rate(gain, errors.task, start_error, clock)
    rate = sub3(rate, matvec(geometry.parent, relative))
    fallback = axpy(fallback_gain(gain, clock), errors.edge, relative)
    solution = _solve(geometry, rate, fallback, config)
    return Behaviour(
        add3(leader.velocity, solution.velocity),
        errors.task,
        solution.singular_value,
        (0.0, 0.0, 0.0),
        errors.slot,
        errors.edge,
        Beside(errors.slot, leader.velocity, False),
        FormationPlace(errors.slot, leader.velocity),
    )


@kernel
def _planned(
    errors: FormationErrors,
    geometry: TaskGeometry,
    parent: Neighbour,
    leader: Neighbour,
    epoch: EpochErrors,
    clock: Clock,
    config: AgentConfig,
) -> Behaviour:
    """v_i = v_L - z_dot E_0 + (Xi + (1 - rho) kappa) D + rho (kappa d + d_j)  (3,) [m/s, ENU], in place of (30).

    E (`slot`) is the error in the leader's frame, e (`edge`) the error relative to the parent; D = E - z E_0
    (`beside_plan`) and d = e - z e_0 (`beside_edge`) are their deviations from the plan, and d_j (`follow`) is the
    velocity of the parent beside its own plan. z is 1 - h(t / T), turned, with T the duration of the plan, and rho is
    `_SHARE`. After tf the task has J^+ (kappa (sigma_d - sigma) - J_j d_j) in place of kappa d + d_j. A child takes rho
    times the deviation of its parent: the gain per hop is rho, whatever the vehicle and the delay
    (docs/notes/chains.md). After an encounter D and d count from the UAV's own way back.
    """
    gain = config.formation
    kappa = gain.scale * gain.kappa
    plan = turned_step(plan_duration(gain), config.turn, clock)
    slot_start, edge_start = epoch.start.slot, epoch.start.edge  # E_0, e_0
    if epoch.at_epoch:
        slot_start, edge_start = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if plan.left.up > _LEAST_LEFT:
            slot_start = start_of(plan.left, errors.slot)
            edge_start = start_of(plan.left, errors.edge)

    # d_j as it was when the parent told it: extrapolated over a delay, it would grow from hop to hop
    late, parent_start = parent.delay_s, sub3(slot_start, edge_start)
    swerve = sub3(parent.acceleration, leader.acceleration)
    swerve = plus_scaled(-1.0, plan.acceleration, parent_start, swerve)
    follow = sub3(parent.velocity, leader.velocity)
    follow = axpy(-late, swerve, plus_scaled(-1.0, plan.rate, parent_start, follow))
    edge = axpy(-0.5 * late * late, swerve, axpy(-late, follow, errors.edge))

    back = way_back(epoch.recovery, clock, kappa)
    own = plus_scaled(-1.0, plan.left, slot_start, errors.slot)
    relative = plus_scaled(-1.0, plan.left, edge_start, edge)
    beside_plan, beside_edge = sub3(own, back.deviation), sub3(relative, back.deviation)

    rate = sub3(scale3(kappa, errors.task), matvec(geometry.parent, follow))
    by_task = _solve(geometry, rate, axpy(kappa, edge, follow), config)
    weight = _SHARE * _task_weight(norm3(edge), by_task.singular_value, clock.t, config)
    weight *= back.progress
    by_position = axpy(kappa, beside_edge, follow)
    correction = axpy(weight, by_task.velocity, scale3(_SHARE - weight, by_position))
    xi = gain.scale * step_gain(clock.t, clock.dt, gain.duration_s, gain.residual)
    correction = axpy(xi + (1.0 - _SHARE) * kappa, beside_plan, correction)
    far = max(norm3(beside_plan), norm3(beside_edge))
    shared = scale3(_SHARE, follow)
    correction = braked(correction, shared, far, kappa + xi, config)
    lead = axpy(_SHARE, swerve, leader.acceleration)
    planned = plus_scaled(1.0, plan.rate, slot_start, leader.velocity)
    itself = axpy(_SHARE, relative, scale3(1.0 - _SHARE, own))
    return Behaviour(
        add3(add3(planned, back.velocity), correction),
        errors.task,
        by_task.singular_value,
        add3(plus_scaled(1.0, plan.acceleration, slot_start, lead), back.acceleration),
        slot_start,
        edge_start,
        Beside(itself, add3(planned, shared), True),
        FormationPlace(errors.slot, leader.velocity),
    )


@inline_kernel
def braked(
    correction: Vector3, free: Vector3, distance: float, gain: float, config: AgentConfig
) -> Vector3:
    """`correction`, whose part beside the feed-forward `free` closes a `distance` [m] with half of the braking.

    A UAV that avoidance led far from its plan would otherwise come back faster than it can stop, and circle. Nor is it
    faster than its way back may be: what stands in its way is seen within the range of the sensor only.
    """
    if config.clearance.approach != SPEED_BRAKING:
        return correction
    closing = sub3(correction, free)
    speed = norm3(closing)
    limit = homing_speed(distance, gain, HOMING * config.clearance.deceleration)
    limit = min(limit, config.recovery.speed)
    if speed <= limit:
        return correction
    return axpy(limit / speed, closing, free)


@inline_kernel
def _task_weight(error_m: float, singular_value: float, t: float, config: AgentConfig) -> float:
    """Share of the task [1] against the positions: 1 near a well conditioned shape after tf, else less, down to 0.

    An error of the parent reaches the child through J^+ J_j, which grows with 1 / singular_value.
    """
    if config.task == _RELATIVE_POSITION:
        return 0.0
    distance = norm3(config.offset)
    near = min(max((_FAR * distance - error_m) / ((_FAR - _NEAR) * distance), 0.0), 1.0)
    near *= min(max((singular_value - _SINGULAR) / (_CONDITIONED - _SINGULAR), 0.0), 1.0)
    duration = config.formation.duration_s
    return near * min(max((t - duration) / (_HANDOVER * duration), 0.0), 1.0)
