"""Clearance from obstacles and other UAVs, (33)-(38), see docs/method.md.

`set_based`: every near object gives a constraint n.v >= n.v_o - alpha (d - d_d). The formation velocity is changed
as little as possible so that all constraints hold. The binding constraints become the rows of the task with the
highest priority. `switched`: the paper's rule, avoidance first inside d_d and formation first outside.

Positions [m] and velocities [m/s] are world ENU; d_d is the object's keep-out radius plus the own margin.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import (
    axpy,
    div3,
    dot3,
    load3,
    matvec,
    norm3,
    scale3,
    store3,
    sub3,
)
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.nullspace import null_space_projector
from ptnsbc_core.tasks import obstacle_memory
from ptnsbc_core.tasks.contract import ClearanceTask
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    AVOIDANCE_SWITCHED,
    Array,
    ClearanceConfig,
    Vector3,
    Vector3Like,
)

_SWEEPS = 60
_TOLERANCE = 1e-9
_COINCIDENT_M = 1e-6


class ObstacleView(NamedTuple):
    """The near objects that a UAV senses, and its memory of them."""

    near: Array  # (M, 7) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU]
    age_s: float  # of `near`, by which its objects are extrapolated
    memory: Array  # (8, 7) obstacle memory before this tick
    dt: float  # control period [s]


class ClearanceConstraint(NamedTuple):
    """Constraint of one near object: normal . v >= bound."""

    normal: Vector3  # from the object to the UAV
    bound: float  # [m/s], -inf where the two coincide
    depth: float  # d_d - d [m], positive inside


class ClearanceConstraints(NamedTuple):
    """One row per near object."""

    normals: Array  # (M, 3)
    bound: Array  # (M,) [m/s]
    depth: Array  # (M,) [m]


@inline_kernel
def constraint(
    position: Vector3, which: int, view: ObstacleView, config: ClearanceConfig
) -> ClearanceConstraint:
    """Constraint of the near object in row `which`."""
    near = view.near[which]
    velocity = load3(near, 4)
    centre = axpy(view.age_s, velocity, near)
    away = sub3(position, centre)
    distance = norm3(away)
    if distance < _COINCIDENT_M:
        return ClearanceConstraint((0.0, 0.0, 0.0), -np.inf, -np.inf)
    normal = div3(away, distance)
    depth = near[3] + config.margin_m - distance
    alpha = config.gain.kappa
    if depth > 0.0:
        since = obstacle_memory.active_time(view.memory, centre)
        alpha += step_gain(since, view.dt, config.gain.duration_s, config.gain.residual)
    return ClearanceConstraint(
        normal, dot3(normal, velocity) + config.gain.scale * alpha * depth, depth
    )


@kernel
def constraints(
    position: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceConstraints:
    """Constraints of all near objects."""
    count = view.near.shape[0]
    normals = np.empty((count, 3))
    bound = np.empty(count)
    depth = np.empty(count)
    for m in range(count):
        one = constraint(position, m, view, config)
        store3(normals[m], 0, one.normal)
        bound[m] = one.bound
        depth[m] = one.depth
    return ClearanceConstraints(normals, bound, depth)


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


@kernel
def tangent(normal: Vector3Like) -> Vector3:
    """Unit vector along e_z x n, or e_x x n where n is nearly vertical."""
    length = math.hypot(normal[0], normal[1])
    if length > 0.1:
        return -normal[1] / length, normal[0] / length, 0.0
    length = math.hypot(normal[1], normal[2])
    return 0.0, -normal[2] / length, normal[1] / length


@kernel
def _add_circulation(
    velocity: Vector3,
    rows: ClearanceConstraints,
    multipliers: Array,
    near: Array,
    memory: Array,
    config: ClearanceConfig,
) -> Vector3:
    """`velocity` plus a tangential motion around each blocking object, in proportion to how much it blocks."""
    out = velocity
    for m in range(multipliers.shape[0]):
        if multipliers[m] <= 0.0:
            continue
        slot = obstacle_memory.find_slot(memory, near[m])
        if slot < 0:
            continue
        ramp = min(memory[slot, obstacle_memory.ACTIVE_S] / config.ramp_s, 1.0)
        speed = config.circulation * ramp * multipliers[m] * memory[slot, obstacle_memory.SIDE]
        out = axpy(speed, tangent(rows.normals[m]), out)
    return out


@kernel
def _binding_normals(rows: ClearanceConstraints, multipliers: Array) -> Array:
    """Normals (A, 3) of the binding constraints."""
    count = 0
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            count += 1
    out = np.empty((count, 3))
    count = 0
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            store3(out[count], 0, rows.normals[m])
            count += 1
    return out


@kernel
def _row_space_velocity(jacobian: Array, admissible: Vector3) -> Vector3:
    """Part of the admissible velocity in the row space of the binding normals: J^+ bound."""
    if jacobian.shape[0] == 0:
        return 0.0, 0.0, 0.0
    return sub3(admissible, matvec(null_space_projector(jacobian), admissible))


@inline_kernel
def _unconstrained(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> bool:
    """Whether the memory is empty and `velocity` satisfies the constraints of all near objects."""
    if obstacle_memory.any_used(view.memory):
        return False
    for m in range(view.near.shape[0]):
        one = constraint(position, m, view, config)
        if one.bound > dot3(one.normal, velocity):
            return False
    return True


@kernel
def set_based(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The least change of the formation velocity that satisfies all constraints."""
    rows = constraints(position, view, config)
    multipliers = admissible_multipliers(velocity, rows)
    side = np.zeros(multipliers.shape[0])
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            side[m] = dot3(sub3(velocity, load3(view.near[m], 4)), tangent(rows.normals[m]))
    after = obstacle_memory.update(view.memory, view.near, multipliers, side, view.dt, config)
    secondary = velocity
    if obstacle_memory.any_used(after):
        secondary = _add_circulation(velocity, rows, multipliers, view.near, after, config)
        multipliers = admissible_multipliers(secondary, rows)
    admissible = secondary
    for m in range(multipliers.shape[0]):
        admissible = axpy(multipliers[m], rows.normals[m], admissible)
    jacobian = _binding_normals(rows, multipliers)
    return ClearanceTask(_row_space_velocity(jacobian, admissible), jacobian, secondary, after)


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
    after = obstacle_memory.update(view.memory, view.near, binding, no_side, view.dt, config)
    return ClearanceTask(out, jacobian, velocity, after)


@inline_kernel
def clearance(
    position: Vector3, velocity: Vector3, view: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The clearance task by the rule of the configuration; it has no rows while no constraint binds."""
    if config.rule == AVOIDANCE_SWITCHED:
        return switched(position, velocity, view, config)
    if config.rule == AVOIDANCE_OFF or _unconstrained(position, velocity, view, config):
        return ClearanceTask((0.0, 0.0, 0.0), np.empty((0, 3)), velocity, view.memory)
    return set_based(position, velocity, view, config)
