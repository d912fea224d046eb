"""Clearance from obstacles and other UAVs, (33)-(38), equations.md section 4.

`set_based`: every near object demands n.v >= n.v_o - alpha (d - d_d); the formation velocity is changed as
little as possible so that all demands hold, and the demands that bind become the rows of the top-priority
task. `switched`: the paper's rule, avoidance first inside d_d and formation first outside.

Positions [m] and velocities [m/s] are world ENU; d_d is the object's keep-out radius plus the own margin.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import (
    divided,
    dot3,
    minus,
    moved,
    norm3,
    put3,
    scaled,
    three,
    times,
)
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.nullspace import projector
from ptnsbc_core.tasks import encounters as memory
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    AVOIDANCE_SWITCHED,
    Array,
    ClearanceConfig,
    Triple,
    Vector3,
)

_SWEEPS = 60
_TOLERANCE = 1e-9
_COINCIDENT_M = 1e-6


_NOTHING: Vector3 = (0.0, 0.0, 0.0)


class ObstacleView(NamedTuple):
    """What a UAV sees, and what it remembers of it."""

    near: Array  # (M, 7) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU]
    age_s: float  # of `near`: its objects are moved on by their velocity
    encounters: Array  # (8, 7) memory before this tick
    dt: float  # control period [s]


class Demand(NamedTuple):
    """What one near object asks for: normal . v >= least."""

    normal: Vector3  # from the object to the UAV
    least: float  # [m/s], -inf where the two coincide
    depth: float  # d_d - d [m], positive inside


class Demands(NamedTuple):
    """One row per near object."""

    normals: Array  # (M, 3)
    least: Array  # (M,) [m/s]
    depth: Array  # (M,) [m]


class ClearanceTask(NamedTuple):
    """The top-priority task at one tick."""

    velocity: Vector3  # J^+ of the binding demands [m/s]; zero without any
    jacobian: Array  # (A, 3) their normals
    below: Vector3  # velocity for the level below: the formation's, with circulation added
    encounters: Array  # memory after this tick


@leaf
def demand(position: Vector3, which: int, around: ObstacleView, config: ClearanceConfig) -> Demand:
    """Of the near object in row `which`."""
    near = around.near[which]
    velocity = three(near, 4)
    centre = moved(near, around.age_s, velocity)
    away = minus(position, centre)
    distance = norm3(away)
    if distance < _COINCIDENT_M:
        return Demand(_NOTHING, -np.inf, -np.inf)
    normal = divided(away, distance)
    depth = near[3] + config.margin_m - distance
    alpha = config.gain.kappa
    if depth > 0.0:
        since = memory.active_time(around.encounters, centre)
        alpha += step_gain(since, around.dt, config.gain.duration_s, config.gain.residual)
    return Demand(normal, dot3(normal, velocity) + config.gain.scale * alpha * depth, depth)


@kernel
def demands(position: Vector3, around: ObstacleView, config: ClearanceConfig) -> Demands:
    """Rows for all near objects."""
    count = around.near.shape[0]
    normals = np.empty((count, 3))
    least = np.empty(count)
    depth = np.empty(count)
    for m in range(count):
        one = demand(position, m, around, config)
        put3(normals[m], 0, one.normal)
        least[m] = one.least
        depth[m] = one.depth
    return Demands(normals, least, depth)


@kernel
def nearest_admissible(velocity: Vector3, rows: Demands) -> Array:
    """Multipliers (M,) [m/s] of the admissible velocity nearest to `velocity`, by Hildreth's sweeps.

    The admissible velocity is velocity + sum of multiplier * normal; a positive multiplier marks a demand
    that binds. Demands that contradict each other end at the sweep limit with the last compromise.
    """
    count = rows.least.shape[0]
    multipliers = np.zeros(count)
    v = velocity
    for _ in range(_SWEEPS):
        change = 0.0
        for m in range(count):
            lack = rows.least[m] - dot3(rows.normals[m], v)
            new = max(0.0, multipliers[m] + lack) if lack > -np.inf else 0.0
            step = new - multipliers[m]
            if step != 0.0:
                multipliers[m] = new
                change = max(change, abs(step))
                v = moved(v, step, rows.normals[m])
        if change < _TOLERANCE:
            break
    return multipliers


@kernel
def tangent(normal: Triple) -> Vector3:
    """Unit vector along e_z x n, or e_x x n where n is nearly vertical."""
    length = math.hypot(normal[0], normal[1])
    if length > 0.1:
        return -normal[1] / length, normal[0] / length, 0.0
    length = math.hypot(normal[1], normal[2])
    return 0.0, -normal[2] / length, normal[1] / length


@kernel
def _circulated(
    velocity: Vector3,
    rows: Demands,
    multipliers: Array,
    near: Array,
    encounters: Array,
    config: ClearanceConfig,
) -> Vector3:
    """Add to `velocity` a motion around what blocks it, in proportion to how much it blocks."""
    out = velocity
    for m in range(multipliers.shape[0]):
        if multipliers[m] <= 0.0:
            continue
        slot = memory.find(encounters, near[m])
        if slot < 0:
            continue
        rise = min(encounters[slot, memory.ACTIVE_S] / config.ramp_s, 1.0)
        push = config.circulation * rise * multipliers[m] * encounters[slot, memory.SIDE]
        out = moved(out, push, tangent(rows.normals[m]))
    return out


@kernel
def _binding(rows: Demands, multipliers: Array) -> Array:
    """Normals (A, 3) of the demands that bind."""
    count = 0
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            count += 1
    out = np.empty((count, 3))
    count = 0
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            put3(out[count], 0, rows.normals[m])
            count += 1
    return out


@kernel
def _velocity_of(jacobian: Array, admissible: Vector3) -> Vector3:
    """Part of the admissible velocity in the row space of the binding normals: J^+ least."""
    if jacobian.shape[0] == 0:
        return 0.0, 0.0, 0.0
    return minus(admissible, times(projector(jacobian), admissible))


@leaf
def _free(
    position: Vector3, velocity: Vector3, around: ObstacleView, config: ClearanceConfig
) -> bool:
    """Whether no encounter is remembered and no near object asks for more than `velocity` gives it."""
    if memory.any_met(around.encounters):
        return False
    for m in range(around.near.shape[0]):
        one = demand(position, m, around, config)
        if one.least > dot3(one.normal, velocity):
            return False
    return True


@kernel
def set_based(
    position: Vector3, velocity: Vector3, around: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """Least change of the formation velocity that keeps clear of all near objects."""
    rows = demands(position, around, config)
    multipliers = nearest_admissible(velocity, rows)
    side = np.zeros(multipliers.shape[0])
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            side[m] = dot3(minus(velocity, three(around.near[m], 4)), tangent(rows.normals[m]))
    after = memory.update(around.encounters, around.near, multipliers, side, around.dt, config)
    below = velocity
    if memory.any_met(after):
        below = _circulated(velocity, rows, multipliers, around.near, after, config)
        multipliers = nearest_admissible(below, rows)
    admissible = below
    for m in range(multipliers.shape[0]):
        admissible = moved(admissible, multipliers[m], rows.normals[m])
    jacobian = _binding(rows, multipliers)
    return ClearanceTask(_velocity_of(jacobian, admissible), jacobian, below, after)


@kernel
def switched(
    position: Vector3, velocity: Vector3, around: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The paper's rule (36)-(38) for the object deepest inside its keep-out; (34) with (d_d - d) kept signed."""
    rows = demands(position, around, config)
    deepest = -1
    for m in range(rows.depth.shape[0]):
        if rows.depth[m] > 0.0 and (deepest < 0 or rows.depth[m] > rows.depth[deepest]):
            deepest = m
    hits = np.zeros(rows.depth.shape[0])
    jacobian = np.empty((0, 3))
    out = (0.0, 0.0, 0.0)
    if deepest >= 0:
        hits[deepest] = 1.0
        jacobian = rows.normals[deepest : deepest + 1].copy()
        out = scaled(rows.least[deepest], rows.normals[deepest])
    idle = np.zeros(hits.shape[0])
    after = memory.update(around.encounters, around.near, hits, idle, around.dt, config)
    return ClearanceTask(out, jacobian, velocity, after)


@leaf
def clearance(
    position: Vector3, velocity: Vector3, around: ObstacleView, config: ClearanceConfig
) -> ClearanceTask:
    """The rule that the configuration names; what asks for nothing changes nothing."""
    if config.rule == AVOIDANCE_SWITCHED:
        return switched(position, velocity, around, config)
    if config.rule == AVOIDANCE_OFF or _free(position, velocity, around, config):
        return ClearanceTask(_NOTHING, np.empty((0, 3)), velocity, around.encounters)
    return set_based(position, velocity, around, config)
