"""Clearance from obstacles and other UAVs, (33)-(38), see docs/method.md.

`set_based`: every near object gives a constraint n.v >= b, see near_constraints.py. The formation velocity is changed
as little as possible so that all constraints hold. The binding constraints become the rows of the task with the
highest priority. `switched`: the paper's rule, avoidance first inside d_d and formation first outside.

Positions [m] and velocities [m/s] are world ENU; d_d is the object's keep-out radius plus the own margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, dot3, limit_norm, load3, matvec, scale3, store3, sub3
from ptnsbc_core.kernel import by_reference, inline_kernel, kernel
from ptnsbc_core.nullspace import null_space_projector
from ptnsbc_core.tasks.near_constraints import (
    ACTIVE_S,
    LATENCIES,
    ClearanceConstraints,
    ObstacleView,
    any_used,
    braking_speed,
    constraint,
    constraints,
    find_slot,
    is_stale,
    landmarks_of,
    side_of,
    surely_kept,
    tangent,
    update_memory,
)
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    AVOIDANCE_SWITCHED,
    SPEED_BRAKING,
    Array,
    ClearanceConfig,
    ClearanceTask,
    Vector3,
)

_SWEEPS = 60
_TOLERANCE = 1e-9
_STALL = 0.25
"""Share of the wanted velocity above which a UAV makes progress."""


@kernel
def admissible_multipliers(velocity: Vector3, rows: ClearanceConstraints) -> Array:
    """Multipliers (M,) [m/s] of the admissible velocity nearest to `velocity`, by Hildreth's method.

    The admissible velocity is velocity + sum of multiplier * normal. A positive multiplier marks a binding
    constraint. For constraints that contradict each other the iteration ends at the sweep limit.
    """
    count = rows.bound.shape[0]
    multipliers = np.zeros(count)
    v = velocity
    for _ in range(_SWEEPS):
        change = 0.0
        for m in range(count):
            deficit = rows.bound[m] - dot3(rows.normals[m], v)
            new = max(0.0, multipliers[m] + deficit) if deficit > -np.inf else 0.0
            step = new - multipliers[m]
            if step != 0.0:
                multipliers[m] = new
                change = max(change, abs(step))
                v = axpy(step, rows.normals[m], v)
        if change < _TOLERANCE:
            break
    return multipliers


@inline_kernel
def _stalled(
    velocity: Vector3, admissible: Vector3, moving: Vector3, config: ClearanceConfig
) -> float:
    """The lack of progress that the admissible velocity leaves beside an object that moves: 1 none, 0 enough."""
    if config.approach != SPEED_BRAKING or dot3(moving, moving) == 0.0:
        return 1.0
    wanted = sub3(velocity, moving)
    progress = dot3(sub3(admissible, moving), wanted)
    return min(max(1.0 - progress / (_STALL * dot3(wanted, wanted) + _TOLERANCE), 0.0), 1.0)


@kernel
def _add_circulation(
    velocity: Vector3,
    rows: ClearanceConstraints,
    multipliers: Array,
    near: Array,
    landmarks: Array,
    memory: Array,
    config: ClearanceConfig,
) -> Vector3:
    """v_2 = v + sum of c r_m lambda_m s_m t_m: a motion along the tangent t_m (3,) of each object m that blocks.

    lambda_m is the multiplier of its constraint, r_m a ramp and s_m the side.

    Around what moves only where it leaves the UAV no progress: it may be another UAV that moves along with this one.
    """
    out = velocity
    admissible = velocity
    for m in range(multipliers.shape[0]):
        admissible = axpy(multipliers[m], rows.normals[m], admissible)
    for m in range(multipliers.shape[0]):
        if multipliers[m] <= 0.0:
            continue
        slot = find_slot(memory, landmarks[m])
        if slot < 0:
            continue
        ramp = min(memory[slot, ACTIVE_S] / config.ramp_s, 1.0)
        speed = config.circulation * ramp * multipliers[m]
        speed *= side_of(memory, slot, config.timeout_s)
        speed *= _stalled(velocity, admissible, load3(near[m], 4), config)
        out = axpy(speed, tangent(rows.normals[m]), out)
    return out


@inline_kernel
def _unconstrained(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> bool:
    """True if the memory is empty and `velocity` satisfies the constraints of all near objects on straight paths.

    The told paths only loosen constraints: they are looked at where straight paths bind.
    """
    if any_used(view.memory):
        return False
    for m in range(view.near.shape[0]):
        if surely_kept(position, velocity, m, view, config):
            continue
        row = constraint(position, m, view, True, config)
        if row.bound > dot3(row.normal, velocity):
            return False
    return True


@kernel
def set_based(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """v = argmin |v - v_2|^2 with n_m.v >= b_m for all m; n (M, 3), b (M,) [m/s].

    v_2 is the formation velocity, plus a circulation around what blocks it. The binding n are the rows of the task.
    """
    rows = constraints(position, view, config)
    multipliers = admissible_multipliers(velocity, rows)
    side = np.zeros(multipliers.shape[0])
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            moving = load3(view.near[m], 4)
            side[m] = dot3(sub3(velocity, moving), tangent(rows.normals[m]))
            if config.approach == SPEED_BRAKING and dot3(moving, moving) > 0.0:
                side[m] = 1.0  # both of a pair, and all of a ring, turn the same way
    landmarks = landmarks_of(view.near, rows.normals)
    after = update_memory(view.memory, landmarks, multipliers, side, view.dt, config)
    secondary = velocity
    if any_used(after):
        secondary = _add_circulation(
            velocity, rows, multipliers, view.near, landmarks, after, config
        )
        multipliers = admissible_multipliers(secondary, rows)
    admissible, count = secondary, 0
    normals = np.empty(rows.normals.shape)
    for m in range(multipliers.shape[0]):
        admissible = axpy(multipliers[m], rows.normals[m], admissible)
        if multipliers[m] > 0.0:
            store3(normals[count], 0, rows.normals[m])
            count += 1
    jacobian, velocity = normals[:count], (0.0, 0.0, 0.0)
    if count > 0:  # J^+ b: the part of the admissible velocity in the row space of the binding n
        velocity = sub3(admissible, matvec(null_space_projector(jacobian), admissible))
    return ClearanceTask(velocity, jacobian, secondary, after)


@kernel
def switched(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The paper's rule (36)-(38) for the near object with the largest depth; (34) with (d_d - d) kept signed."""
    rows = constraints(position, view, config)
    deepest = -1
    for m in range(rows.depth.shape[0]):
        if rows.depth[m] > 0.0 and (deepest < 0 or rows.depth[m] > rows.depth[deepest]):
            deepest = m
    binding = np.zeros(rows.depth.shape[0])
    jacobian = np.empty((0, 3))
    out = (0.0, 0.0, 0.0)
    if deepest >= 0:
        binding[deepest] = 1.0
        jacobian = rows.normals[deepest : deepest + 1].copy()
        out = scale3(rows.bound[deepest], rows.normals[deepest])
    no_side = np.zeros(binding.shape[0])
    landmarks = landmarks_of(view.near, rows.normals)
    after = update_memory(view.memory, landmarks, binding, no_side, view.dt, config)
    return ClearanceTask(out, jacobian, velocity, after)


@inline_kernel
def _within_sight(velocity: Vector3, view: ObstacleView, config: ClearanceConfig) -> Vector3:
    """`velocity`, limited to what can be braked within the range of the sensor once the sensor has long been silent."""
    if config.rule == AVOIDANCE_OFF or not is_stale(view, config):
        return velocity
    latency = LATENCIES * (config.lag_s + view.age_s)
    return limit_norm(velocity, braking_speed(config.range_m, config.deceleration, latency))


@inline_kernel
def clearance(
    position: Vector3, wanted: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The clearance task by the rule of the configuration; it has no rows while no constraint binds."""
    view = by_reference(view)
    velocity = _within_sight(wanted, view, config)
    if config.rule == AVOIDANCE_SWITCHED:
        return switched(position, velocity, view, config)
    if config.rule == AVOIDANCE_OFF or _unconstrained(position, velocity, view, config):
        # a new array would cost an allocation at every tick
        return ClearanceTask((0.0, 0.0, 0.0), view.memory[:0], velocity, view.memory)
    return set_based(position, velocity, view, config)


class FilterPace(NamedTuple):
    """The limits of the command filter."""

    bandwidth: float  # [1/s]
    acceleration: float  # [m/s^2]


@inline_kernel
def filter_pace(memory: Array, free: FilterPace, config: ClearanceConfig) -> FilterPace:
    """During an encounter no faster than the loops below the filter, and than the vehicle can accelerate.

    The rate of the command is fed forward and reaches the vehicle a lag later. A command that turns within that lag
    makes the velocity overshoot by as much as it turned, and so does a command that ran ahead of the vehicle.
    """
    if config.approach != SPEED_BRAKING or not any_used(memory):
        return free
    return FilterPace(
        min(free.bandwidth, config.bandwidth), min(free.acceleration, config.deceleration)
    )
