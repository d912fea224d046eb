"""One control step of one UAV: estimator, behaviours, null-space composition, command filter, controller.

`step` is the only place where the laws meet. The headless swarm calls it; the processes and every replay call it
through `agent`.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.algebra import add3, load3, norm3, sub3, wrap_angle
from ptnsbc_core.behaviours.formation import formation, is_plan_left
from ptnsbc_core.behaviours.mission import (
    attitude,
    desired_yaw,
    hold_behaviour,
    hold_target,
    leader_tracking,
    link_lost,
    with_velocity,
)
from ptnsbc_core.behaviours.neighbour import (
    UNKNOWN,
    neighbour_motion,
    parent_and_leader,
    reported_velocity,
)
from ptnsbc_core.behaviours.recovery import (
    DISTURBED,
    UNDISTURBED,
    armed,
    in_deadlock,
    standing_time,
    stands_still,
    way_out,
)
from ptnsbc_core.control.quadrotor_control import quadrotor_control
from ptnsbc_core.control.rigid_body_control import (
    ControlInput,
    VelocityReference,
    filter_step,
    initial_observer,
    rigid_body_control,
)
from ptnsbc_core.curves.trajectory import Reference, reference
from ptnsbc_core.curves.turned import ToldPaths
from ptnsbc_core.estimator import leader_estimate
from ptnsbc_core.kernel import by_reference, inline_kernel, kernel
from ptnsbc_core.kinematics import state_to_estimate, velocity_enu, yaw_of
from ptnsbc_core.nullspace import compose_with_clearance
from ptnsbc_core.tasks.clearance import FilterPace, clearance, filter_pace
from ptnsbc_core.tasks.formation_tasks import TaskGeometry
from ptnsbc_core.tasks.near_constraints import ObstacleView, drift, empty_memory
from ptnsbc_core.timebase import Clock, loop_gain, plan_duration
from ptnsbc_core.types import (
    APPROACH_PLANNED,
    MODE_FORMATION,
    MODE_HOLD,
    NEVER_RECEIVED_S,
    PLANT_RIGID_BODY,
    AdaptationState,
    AgentConfig,
    AgentDiagnostics,
    AgentInputs,
    AgentOutputs,
    AgentState,
    Array,
    Behaviour,
    Beside,
    EpochErrors,
    Estimate,
    NeighbourMotions,
    OdometryLike,
    PoseTarget,
    Recovery,
    StartErrors,
    Vector3,
)

_NO_MODE = -1


@inline_kernel
def initial_state(own: OdometryLike, config: AgentConfig) -> AgentState:
    """State before the first tick, from the UAV's own odometry vector (13,)."""
    velocity, zero = velocity_enu(own), (0.0, 0.0, 0.0)
    return AgentState(
        state_to_estimate(own),
        False,
        velocity,
        zero,
        AdaptationState(config.controller.nominal, (0.0, 0.0), initial_observer(velocity)),
        empty_memory(),
        StartErrors(zero, zero, zero, zero),
        UNDISTURBED,
        0.0,
        NeighbourMotions(UNKNOWN, UNKNOWN),
        PoseTarget(load3(own, 0), yaw_of(own)),
        _NO_MODE,
        0.0,
    )


@inline_kernel
def _control(
    state: AgentState,
    inputs: AgentInputs,
    command: VelocityReference,
    clock: Clock,
    config: AgentConfig,
) -> ControlInput:
    """Force and torque by the controller of the plant's kind."""
    # only the first epoch starts the inner loops
    inner = Clock(clock.start_t, clock.start_t, clock.dt)
    own, before, controller = inputs.own, state.adapted, config.controller
    if controller.plant == PLANT_RIGID_BODY:
        return rigid_body_control(own, command, before, inner, controller)
    return quadrotor_control(own, command, before, inner, controller, config.filter.max_rate)


@inline_kernel
def _told_paths(estimate: Estimate, planned: bool, t: float, config: AgentConfig) -> ToldPaths:
    """The announced paths of the UAVs of the formation."""
    return ToldPaths(
        t,
        plan_duration(config.formation) if planned else 0.0,
        estimate.position,
        estimate.velocity,
        config.slot,
        config.other_slots,
        config.slot_reach,
        config.turn,
    )


class PlannerOutput(NamedTuple):
    """Command of the planner to the controller."""

    command: VelocityReference
    obstacle_memory: Array  # (8, 7)
    active_rows: int
    saturated: bool
    violation: float  # [m/s]


@inline_kernel
def _plan(
    state: AgentState,
    inputs: AgentInputs,
    behaviour: Behaviour,
    told: ToldPaths,
    rates: Vector3,
    yaw: float,
    dt: float,
    config: AgentConfig,
) -> PlannerOutput:
    """Clearance above the behaviour, the speed limit, and the command filter."""
    # without any message of the sensor its silence counts from the first epoch
    age_s = inputs.near_age_s if inputs.near_age_s < NEVER_RECEIVED_S else inputs.start_age_s
    demand = norm3(behaviour.acceleration) + norm3(state.adapted.observer.disturbance)
    velocity = velocity_enu(inputs.own)
    observer = state.adapted.observer
    acceleration = add3(observer.acceleration, observer.disturbance)
    way = drift(velocity, state.velocity, acceleration, config.clearance)
    view = ObstacleView(
        inputs.near, age_s, state.obstacle_memory, dt, velocity, state.velocity, demand, way, told
    )
    wanted = way_out(behaviour.velocity, behaviour.place, state.standing_s, config.clearance)
    task = clearance(load3(inputs.own, 0), wanted, view, config.clearance)
    limits = config.filter
    composed = compose_with_clearance(task, limits.max_speed)
    rows, zero = task.jacobian.shape[0], (0.0, 0.0, 0.0)
    if rows == 0 and task.secondary != behaviour.velocity:
        rows = 1
    free = config.approach == APPROACH_PLANNED and rows == 0 and not composed.limited
    lead = behaviour.acceleration if free else zero
    pace = FilterPace(limits.bandwidth, limits.max_acceleration)
    pace = filter_pace(task.memory, pace, config.clearance)
    linear = filter_step(
        state.velocity, composed.velocity, lead, pace.bandwidth, pace.acceleration, dt
    )
    angular = filter_step(
        state.rates, rates, zero, limits.rate_bandwidth, limits.max_rate_acceleration, dt
    )
    return PlannerOutput(
        VelocityReference(linear.value, linear.rate, angular.value, angular.rate, yaw),
        task.memory,
        rows,
        composed.limited or linear.saturated,
        composed.violation,
    )


@inline_kernel
def _standing_s(
    state: AgentState, planned: PlannerOutput, behaviour: Behaviour, dt: float, config: AgentConfig
) -> float:
    """Time [s] that the UAV has had no way to its place, after this tick."""
    still = stands_still(behaviour.velocity, planned.command.velocity, behaviour.place)
    still = still and planned.active_rows > 0
    return standing_time(state.standing_s, still, dt, config.clearance)


@inline_kernel
def _recovery(
    before: Recovery,
    disturbed: bool,
    beside: Beside,
    command: VelocityReference,
    clock: Clock,
    config: AgentConfig,
) -> Recovery:
    """The way back after this tick; the first step of its time base is the next tick."""
    if disturbed:
        return DISTURBED
    if not before.disturbed:
        return before
    if not beside.planned:
        return UNDISTURBED
    kappa = config.formation.scale * config.formation.kappa
    closing = sub3(command.velocity, beside.velocity)
    return armed(beside.deviation, closing, clock.t + clock.dt, kappa, config.recovery)


@inline_kernel
def _motions(
    state: AgentState, inputs: AgentInputs, clock: Clock, config: AgentConfig
) -> NeighbourMotions:
    """The motion of parent and leader in their newest messages."""
    before, start_t = state.motions, clock.start_t
    limit, stale_s = config.filter.max_acceleration, config.stale_s
    if config.approach != APPROACH_PLANNED:
        limit = 0.0  # a measured velocity gives no acceleration worth having
    return NeighbourMotions(
        neighbour_motion(
            before.parent, inputs.parent, inputs.parent_age_s, start_t, stale_s, limit
        ),
        neighbour_motion(
            before.leader, inputs.leader, inputs.leader_age_s, start_t, stale_s, limit
        ),
    )


@inline_kernel
def _yaw_rate(inputs: AgentInputs, command: VelocityReference, config: AgentConfig) -> float:
    """Yaw rate setpoint [rad/s] for a vehicle that closes its own loops."""
    if config.controller.plant == PLANT_RIGID_BODY:
        return command.rates[2]
    error = wrap_angle(command.yaw - yaw_of(inputs.own))
    limit = config.filter.max_rate
    return min(max(config.controller.attitude_gain[1] * error, -limit), limit)


@inline_kernel
def _behaviour(
    inputs: AgentInputs,
    estimate: Estimate,
    motions: NeighbourMotions,
    epoch: EpochErrors,
    clock: Clock,
    config: AgentConfig,
    task: TaskGeometry | None,
) -> Behaviour:
    """Leader tracking for the leader, formation for a follower; one that has not heard its parent stays where it is."""
    position = load3(inputs.own, 0)
    if config.leader:
        desired = reference(config.trajectory, clock.start_t)
        return leader_tracking(sub3(position, config.leader_slot), desired, epoch, clock, config)
    if inputs.parent_age_s >= NEVER_RECEIVED_S:
        rest = Reference(position, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0))
        return leader_tracking(position, rest, epoch, clock, config)
    parent, leader = parent_and_leader(inputs, estimate, motions, clock, config)
    return formation(position, parent, leader, epoch, clock, config, task)


class TaskPoints(NamedTuple):
    """The points of a formation task at one tick."""

    own: Vector3  # [m, ENU]
    parent: Vector3  # [m, ENU]
    reference: Vector3  # [m, ENU]
    heard: bool  # the parent has been heard: without it the task does not count


@kernel
def task_points(
    state: AgentState, inputs: AgentInputs, t: float, dt: float, config: AgentConfig
) -> TaskPoints:
    """The state at which the step that follows evaluates its task."""
    inputs, config = by_reference(inputs), by_reference(config)
    clock = Clock(t, inputs.start_age_s, dt)
    lost = link_lost(inputs, clock.start_t, config)
    motions = _motions(state, inputs, clock, config)
    estimate, _ = leader_estimate(state, inputs, motions.leader, clock, lost, config)
    parent, leader = parent_and_leader(inputs, estimate, motions, clock, config)
    return TaskPoints(
        load3(inputs.own, 0),
        parent.position,
        add3(leader.position, config.anchor),
        inputs.parent_age_s < NEVER_RECEIVED_S,
    )


@inline_kernel
def epoch_begins(state: AgentState, t: float) -> bool:
    """True at the first step, and at that of a later epoch, from which `t` [s] counts."""
    return state.mode == _NO_MODE or t < state.last_t


@inline_kernel
def _begins_anew(
    state: AgentState, motions: NeighbourMotions, estimate_valid: bool, t: float
) -> bool:
    """True at an epoch, and when the leader's estimate or the parent is heard for the first time or lost."""
    return (
        epoch_begins(state, t)
        or state.estimate_valid != estimate_valid
        or (state.motions.parent.time == UNKNOWN.time) != (motions.parent.time == UNKNOWN.time)
    )


@inline_kernel
def _told_velocity(inputs: AgentInputs, command: VelocityReference, config: AgentConfig) -> Vector3:
    """Velocity [m/s, body FLU] that the neighbours are told: the commanded one, by which a plan can be followed."""
    if config.approach == APPROACH_PLANNED:
        return reported_velocity(inputs.own, command.velocity, config.filter.max_acceleration)
    return load3(inputs.own, 7)


@inline_kernel
def _diagnostics(
    behaviour: Behaviour,
    planned: PlannerOutput,
    control: ControlInput,
    clock: Clock,
    holding: bool,
    standing_s: float,
    config: AgentConfig,
) -> AgentDiagnostics:
    return AgentDiagnostics(
        behaviour.error,
        loop_gain(config.formation, clock),
        behaviour.singular_value,
        planned.active_rows,
        planned.saturated or control.saturated,
        holding,
        planned.violation,
        control.velocity_error,
        in_deadlock(standing_s, config.clearance),
    )


@inline_kernel
def step(
    state: AgentState,
    inputs: AgentInputs,
    t: float,
    dt: float,
    config: AgentConfig,
    guided: Vector3 | None = None,
    task: TaskGeometry | None = None,
) -> tuple[AgentState, AgentOutputs]:
    """One tick: pure, no clock, no randomness, no I/O. Returns the state for the next tick and what to send now.

    `t` [s] counts from the latest epoch; `dt` [s] is the control period. `guided` is the velocity [m/s, ENU] of another
    law in place of the formation law's; clearance, filter and controller act on it, a UAV that holds does not follow
    it. `task` is a task of the user, evaluated at `task_points`. numba drops a branch on None: the two cost nothing.
    """
    inputs, config = by_reference(inputs), by_reference(config)
    clock = Clock(t, inputs.start_age_s, dt)
    lost = link_lost(inputs, clock.start_t, config)
    holding = inputs.mode != MODE_FORMATION or lost
    motions = _motions(state, inputs, clock, config)
    estimate, estimate_valid = leader_estimate(state, inputs, motions.leader, clock, lost, config)
    target = hold_target(state, inputs, holding)
    yaw = desired_yaw(estimate, target, holding, clock, config)

    at_epoch = _begins_anew(state, motions, estimate_valid, t)
    epoch = EpochErrors(at_epoch, state.start, state.recovery)
    if at_epoch:  # with a tenth of the common plan left or less a UAV has a time base of its own
        own_base = UNDISTURBED if is_plan_left(t, config) else DISTURBED
        epoch = EpochErrors(True, state.start, own_base)
    behaviour = _behaviour(inputs, estimate, motions, epoch, clock, config, task)
    rates, euler_error = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if config.controller.plant == PLANT_RIGID_BODY:  # a quadrotor's controller sets its attitude
        rates, euler_error = attitude(inputs.own, yaw, epoch, clock, config)
    start = state.start
    if at_epoch:
        start = StartErrors(
            behaviour.error, euler_error, behaviour.slot_start, behaviour.edge_start
        )
    if guided is not None:
        behaviour = with_velocity(behaviour, guided)
    if holding:
        behaviour = hold_behaviour(behaviour, inputs, target, config)

    on_plan = config.approach == APPROACH_PLANNED and estimate_valid and not holding
    if guided is not None or config.shape.moving:
        on_plan = False  # where the slots are then, `ToldPaths` does not know
    told = _told_paths(estimate, on_plan, t, config)
    planned = _plan(state, inputs, behaviour, told, rates, yaw, dt, config)
    command = planned.command
    control = _control(state, inputs, command, clock, config)
    disturbed = holding or planned.active_rows > 0
    recovery = _recovery(epoch.recovery, disturbed, behaviour.beside, command, clock, config)
    counts = not (at_epoch or holding) and guided is None
    standing_s = _standing_s(state, planned, behaviour, dt, config) if counts else 0.0
    after = AgentState(
        estimate,
        estimate_valid,
        command.velocity,
        command.rates,
        control.adapted,
        planned.obstacle_memory,
        start,
        recovery,
        standing_s,
        motions,
        target,
        max(inputs.mode, MODE_HOLD) if holding else MODE_FORMATION,
        t,
    )
    outputs = AgentOutputs(
        command.velocity,
        _yaw_rate(inputs, command, config),
        control.force,
        control.torque,
        estimate,
        estimate_valid,
        _told_velocity(inputs, command, config),
        _diagnostics(behaviour, planned, control, clock, holding, standing_s, config),
    )
    return after, outputs
