"""From a scenario to the constants of one UAV.

Scalars are exactly float, int or bool, and vectors are tuples of float: numba compiles the kernels for these types.
One UAV with another type would compile everything a second time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ptnsbc_core.behaviours.formation import HOMING
from ptnsbc_core.control.quadrotor_control import MIN_LIFT_FRACTION
from ptnsbc_core.curves.turned import REACH
from ptnsbc_core.errors import FormationError
from ptnsbc_core.tasks.formation_tasks import desired_value, metres_per_row, needs_arm
from ptnsbc_core.tasks.near_constraints import SHARE, braking_speed
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import (
    APPROACH_SPEEDS,
    APPROACHES,
    AVOIDANCE,
    PLANT_QUADROTOR,
    PLANTS,
    TASK_OWN,
    AgentConfig,
    Array,
    ClearanceConfig,
    ControllerConfig,
    EstimatorConfig,
    FilterConfig,
    InertialParameters,
    RecoveryConfig,
    Trajectory,
    Vector3,
    VelocityLoop,
)
from ptnsbc_sim.plugins.formation_task import load_task
from ptnsbc_sim.scenario.approach.deadline import leader_motion, turn_of
from ptnsbc_sim.scenario.fields import kept
from ptnsbc_sim.scenario.gains import gain_of
from ptnsbc_sim.scenario.mission.completion import SHORTEST_ARM_M
from ptnsbc_sim.scenario.mission.route import shape_of
from ptnsbc_sim.scenario.mission.trajectories import trajectory_of
from ptnsbc_sim.scenario.model import plant_of
from ptnsbc_sim.scenario.problems import Problem
from ptnsbc_sim.scenario.scenario import Scenario

_LEAST_LEFT = 0.25  # of speed and braking, whatever the leader does
_UPRIGHT = np.pi / 2  # the tilt limit of a plant that is not tilted


def three(vector: Iterable[float]) -> Vector3:
    """A vector of three numbers as the kernels take it."""
    x, y, z = (float(number) for number in vector)
    return x, y, z


class PlannerLimits(NamedTuple):
    """The largest speed and acceleration that a planner may command; a vehicle may allow less than its scenario."""

    speed_m_s: float
    acceleration_m_s2: float

    @classmethod
    def of(cls, config: AgentConfig) -> PlannerLimits:
        """The limits in the constants of one UAV."""
        return cls(config.filter.max_speed, config.filter.max_acceleration)

    def applied_to(self, config: AgentConfig) -> AgentConfig:
        """The constants with these limits."""
        speed, acceleration = self
        limits = config.filter._replace(max_speed=speed, max_acceleration=acceleration)
        return config._replace(filter=limits)

    def lowering(self, config: AgentConfig) -> AgentConfig:
        """The constants with these limits where they are lower."""
        lower = map(min, PlannerLimits.of(config), self)
        return PlannerLimits(*lower).applied_to(config)


def leader_trajectory(scenario: Scenario) -> Trajectory:
    """The leader's reference as ptnsbc_core.curves.trajectory reads it."""
    return trajectory_of(scenario.leader.trajectory)


def reference_offset(scenario: Scenario, uav_id: int) -> Array:
    """Reference k of a follower, relative to the leader: the leader itself or the heading anchor."""
    if scenario.communication.parent(uav_id) == scenario.leader.id:
        return np.array(scenario.formation.heading_anchor_m, dtype=np.float64)
    return np.zeros(3)


def _offset_from_parent(scenario: Scenario, uav_id: int) -> Array:
    """Desired position relative to the parent (3,) [m], ENU; zeros for the leader."""
    parent = scenario.communication.parent(uav_id)
    if parent is None:
        return np.zeros(3)
    return scenario.offset(uav_id) - scenario.offset(parent)


class SeveralParents(NamedTuple):
    """The share that one UAV takes of each of its parents; see `ptnsbc_core.behaviours.neighbour`."""

    ids: tuple[int, ...]  # (P,)
    weights: Array  # (P,)
    shifts: Array  # (P, 3) [m, ENU] from the slot of each to that of the parent in the tree
    stale_s: float


def several_parents(scenario: Scenario, uav_id: int) -> SeveralParents | None:
    """The parents of a UAV with several; None where it has one."""
    links = scenario.communication
    weights, first = links.weights_of(uav_id), links.parent(uav_id)
    if not weights or first is None:
        return None
    shifts = np.stack([scenario.offset(first) - scenario.offset(parent) for parent in weights])
    shares = np.array(list(weights.values()))
    return SeveralParents(tuple(weights), shares, shifts, float(links.stale_s))


@kept
def _slots(scenario: Scenario) -> Array:
    """Slots of all UAVs relative to the leader, and half of the distance to the next one: rows (N, 4) [m], ENU."""
    slots = np.array([scenario.offset(uav_id) for uav_id in scenario.uav_ids], dtype=np.float64)
    ways = slots[:, np.newaxis] - slots
    squares = (ways * ways).sum(axis=2)
    np.fill_diagonal(squares, np.inf if len(slots) > 1 else 0.0)
    return np.column_stack([slots, 0.5 * np.sqrt(squares.min(axis=1))])


def shape_problem(scenario: Scenario, uav_id: int) -> Problem | None:
    """The reason why a task has no meaning for a follower at its place; None where it has one."""
    task, parent = scenario.formation.task, scenario.communication.parent(uav_id)
    arm_m = float(np.hypot(*_offset_from_parent(scenario, uav_id)[:2]))
    if scenario.plugins.task or parent is None or not needs_arm(task) or arm_m >= SHORTEST_ARM_M:
        return None
    return Problem(
        f"formation.offsets_m.{uav_id}",
        f"{arm_m:.3g} m beside its parent UAV {parent}",
        f"at least {SHORTEST_ARM_M:g} m, the angles of task {task} have no meaning straight above or below",
        "move it, or use task: relative_position",
    )


def _desired(scenario: Scenario, uav_id: int) -> tuple[Vector3, Vector3]:
    """Desired task value and the row scale that puts every row in metres."""
    parent = scenario.communication.parent(uav_id)
    named = scenario.plugins.task
    # The file of a task from a bag is not known: such a scenario is not flown.
    if parent is None or (named and not Path(named).is_absolute()):
        return (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    own, above = scenario.offset(uav_id), scenario.offset(parent)
    anchor = reference_offset(scenario, uav_id)
    if named:
        return load_task(named).desired(own, above, anchor)
    if problem := shape_problem(scenario, uav_id):
        raise FormationError(f"{scenario.source}: {problem}")
    task = scenario.formation.task
    scale = metres_per_row(task, float(np.hypot(*(own - above)[:2])))
    return desired_value(TASKS[task], own, above, anchor), scale


def loop_lag_s(scenario: Scenario) -> float:
    """Lag [s] with which the vehicle follows the filtered command: that of the loops below the filter."""
    gains = scenario.gains
    if gains.clearance.lag_s is not None:
        return float(gains.clearance.lag_s)
    if PLANTS[scenario.plant.kind] != PLANT_QUADROTOR:
        return 1.0 / max(gains.force.scale * gains.force.kappa_1_s, 1.0)
    rate = 1.0 / max(gains.torque.scale * gains.torque.kappa_1_s, 1.0)
    return 1.0 / gains.pointing.tilt_1_s + rate + scenario.plant.rotor_limits.motor_lag_s


def _velocity_loop(scenario: Scenario) -> VelocityLoop:
    """A vehicle of which a lag alone is known follows as one of the first order."""
    gains, lag_s = scenario.gains, loop_lag_s(scenario)
    if gains.clearance.lag_s is not None:
        return VelocityLoop(1.0 / lag_s, 0.0, 0.0)
    attitude_s = lag_s if PLANTS[scenario.plant.kind] == PLANT_QUADROTOR else 0.0
    return VelocityLoop(float(gains.force.scale * gains.force.kappa_1_s), float(attitude_s), 1.0)


def deceleration(scenario: Scenario, uav_id: int) -> float:
    """Acceleration [m/s^2] that a vehicle has in every direction: tilt, descent, climb and the command filter."""
    limit = scenario.gains.filter.max_acceleration_m_s2
    max_tilt, max_thrust, _ = _limits(scenario, uav_id)
    specific, gravity = max_thrust / scenario.vehicle(uav_id).mass_kg, scenario.world.gravity_m_s2
    if PLANTS[scenario.plant.kind] != PLANT_QUADROTOR:
        return float(min(limit, specific - gravity))
    lift = (1.0 - MIN_LIFT_FRACTION) * gravity
    sideways = min(gravity * math.tan(max_tilt), math.sqrt(specific * specific - gravity * gravity))
    return float(min(limit, sideways, lift, specific - gravity))


@kept
def _weakest(scenario: Scenario) -> float:
    """The least `deceleration` of all vehicles."""
    unlike = {plant_of(scenario.plant, uav): uav.id for uav in scenario.uavs}
    return min(deceleration(scenario, uav) for uav in unlike.values())


def clearance_config(scenario: Scenario, uav_id: int) -> ClearanceConfig:
    """Constants of the clearance of one UAV."""
    gains = scenario.gains.clearance
    loops, braking = loop_lag_s(scenario), deceleration(scenario, uav_id)
    # In a second deadlock_s any two are a keep-out apart.
    above_m = scenario.formation.uav_keep_out_above_m or scenario.formation.uav_keep_out_m
    number = 1 + scenario.uav_ids.index(uav_id)
    bandwidth = min(scenario.gains.filter.bandwidth_1_s, 1.0 / loops)
    return ClearanceConfig(
        rule=AVOIDANCE[scenario.formation.avoidance],
        margin_m=float(gains.margin_m),
        gain=gain_of(scenario.gains, gains),
        circulation=float(gains.circulation),
        ramp_s=float(gains.ramp_s),
        timeout_s=float(gains.timeout_s),
        forget_s=float(gains.forget_s),
        approach=APPROACH_SPEEDS[gains.approach],
        deceleration=braking,
        weakest=_weakest(scenario),
        lag_s=float(1.0 / scenario.timing.control_hz + 1.0 / bandwidth + loops),
        bandwidth=float(bandwidth),
        loop=_velocity_loop(scenario),
        sensor_s=float(1.0 / scenario.sensor.rate_hz),
        stale_s=float(gains.stale_s),
        range_m=float(scenario.sensor.range_m),
        deadlock_s=float(gains.deadlock_s),
        climb=float(number * above_m / gains.deadlock_s),
    )


def sight_speed(
    config: ClearanceConfig, keep_out_m: float, busy: float = 0.0, share: float = 1.0
) -> float:
    """Largest speed [m/s] from which a UAV can stop before a keep-out [m] that comes into the sensor's range.

    Until it brakes it flies on for its lag and one period of the sensor, as it did before. `busy` [m/s^2] of its
    braking are in use already. Each of two that both brake has its `share` of the room: `SHARE`.
    """
    room = share * max(config.range_m - keep_out_m - config.margin_m, 0.0)
    return braking_speed(room, config.deceleration - busy, config.lag_s + config.sensor_s)


def recovery_config(scenario: Scenario, uav_id: int) -> RecoveryConfig:
    """The demands of the way back after an encounter: half of what the leader's motion leaves of the vehicle.

    The motion of the leader is common to all and closes no pair. So beside it each of two that come back can stop
    within half of what they see, with the braking that the way back leaves.
    """
    speed, acceleration = leader_motion(scenario)
    most, braking = float(scenario.max_speed_m_s(uav_id)), deceleration(scenario, uav_id)
    half = HOMING * max(braking - acceleration, _LEAST_LEFT * braking)
    left = max(most - speed, _LEAST_LEFT * most)
    if scenario.formation.avoidance != "off":
        config = clearance_config(scenario, uav_id)
        left = min(left, sight_speed(config, scenario.highest_keep_out_m, half, SHARE))
    return RecoveryConfig(
        least_s=float(scenario.formation.recovery_s), speed=float(left), acceleration=float(half)
    )


def recovery_configs(scenario: Scenario) -> dict[int, RecoveryConfig]:
    """`recovery_config` of every UAV; those of like vehicles are one."""
    vehicles = {uav.id: (plant_of(scenario.plant, uav), uav.max_speed_m_s) for uav in scenario.uavs}
    unlike = {vehicle: uav for uav, vehicle in vehicles.items()}
    configs = {vehicle: recovery_config(scenario, uav) for vehicle, uav in unlike.items()}
    return {uav: configs[vehicle] for uav, vehicle in vehicles.items()}


def _limits(scenario: Scenario, uav_id: int) -> tuple[float, float, Vector3]:
    """Tilt [rad], thrust or force [N], torque [N m] of a vehicle."""
    vehicle = scenario.vehicle(uav_id)
    if PLANTS[scenario.plant.kind] == PLANT_QUADROTOR:
        limits = vehicle.rotor_limits
        torque = three(limits.max_torque_nm)
        return float(limits.max_tilt_rad), float(limits.max_thrust_n), torque
    body = vehicle.rigid_body
    return float(_UPRIGHT), float(body.max_force_n), three(body.max_torque_nm)


def _controller(scenario: Scenario, uav_id: int) -> ControllerConfig:
    gains, vehicle = scenario.gains, scenario.vehicle(uav_id)
    adaptation = gains.adaptation
    max_tilt, max_thrust, max_torque = _limits(scenario, uav_id)
    return ControllerConfig(
        plant=PLANTS[scenario.plant.kind],
        gravity=float(scenario.world.gravity_m_s2),
        nominal=InertialParameters(float(vehicle.mass_kg), three(vehicle.inertia_kg_m2)),
        force=gain_of(scenario.gains, gains.force),
        torque=gain_of(scenario.gains, gains.torque),
        boundary=(float(gains.boundary.velocity_m_s), float(gains.boundary.rate_rad_s)),
        adaptation=(float(1.0 / adaptation.gamma_mass), float(1.0 / adaptation.gamma_inertia)),
        mass_range=float(adaptation.mass_range),
        bound_rate=float(1.0 / adaptation.upsilon),
        bound_leak=float(adaptation.leak_1_s),
        bound_dead_zone=(float(adaptation.dead_zone_m_s), float(adaptation.dead_zone_rad_s)),
        bound_cap=(float(adaptation.cap_m_s2), float(adaptation.cap_rad_s2)),
        observer_bandwidth=float(gains.observer.bandwidth_1_s),
        attitude_gain=(float(gains.pointing.tilt_1_s), float(gains.pointing.yaw_1_s)),
        max_tilt=max_tilt,
        max_thrust=max_thrust,
        max_torque=max_torque,
    )


def agent_config(scenario: Scenario, uav_id: int) -> AgentConfig:
    """Everything constant that one UAV's control step needs."""
    scenario.uav(uav_id)  # names the ids there are when this is not one
    slots, row = _slots(scenario), scenario.uav_ids.index(uav_id)
    others = sorted(np.delete(slots, row, axis=0).tolist())  # whoever takes which
    desired, row_scale = _desired(scenario, uav_id)
    gains, estimator, limits = scenario.gains, scenario.gains.estimator, scenario.gains.filter
    return AgentConfig(
        leader=bool(uav_id == scenario.leader.id),
        task=TASK_OWN if scenario.plugins.task else TASKS[scenario.formation.task],
        approach=APPROACHES[scenario.formation.approach],
        turn=turn_of(scenario),
        desired=desired,
        offset=three(_offset_from_parent(scenario, uav_id)),
        slot=three(scenario.offset(uav_id)),
        leader_slot=three(scenario.offset(scenario.leader.id)),
        slot_reach=float(slots[row, REACH]),
        other_slots=np.array(others, dtype=np.float64).reshape(-1, 4),
        anchor=three(reference_offset(scenario, uav_id)),
        row_scale=row_scale,
        formation=gain_of(scenario.gains, gains.formation),
        attitude=gain_of(scenario.gains, gains.attitude),
        damping_threshold=float(gains.damping.threshold),
        damping_max=float(gains.damping.maximum),
        estimator=EstimatorConfig(
            duration_s=float(estimator.deadline_s),
            residual=float(estimator.residual) if estimator.time_base else math.inf,
            lambda_min=float(scenario.topology.lambda_min),
            k1=float(estimator.k1_1_s),
            k2=float(estimator.k2),
            boundary=float(estimator.boundary),
            pinned=bool(uav_id in scenario.topology.pinned),
            feed_forward=bool(estimator.feed_forward),
        ),
        clearance=clearance_config(scenario, uav_id),
        recovery=recovery_config(scenario, uav_id),
        filter=FilterConfig(
            bandwidth=float(limits.bandwidth_1_s),
            rate_bandwidth=float(limits.rate_bandwidth_1_s),
            max_speed=float(scenario.max_speed_m_s(uav_id)),
            max_acceleration=float(limits.max_acceleration_m_s2),
            max_rate=float(limits.max_rate_rad_s),
            max_rate_acceleration=float(limits.max_rate_acceleration_rad_s2),
        ),
        controller=_controller(scenario, uav_id),
        trajectory=leader_trajectory(scenario),
        shape=shape_of(scenario, uav_id),
        association_gate_m=float(scenario.formation.sight_m),
        stale_s=float(scenario.communication.stale_s),
        hold_gain=float(gains.hold.gain_1_s),
        land_speed=float(gains.hold.land_speed_m_s),
    )
