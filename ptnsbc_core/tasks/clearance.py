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

from ptnsbc_core.algebra import divided, dot3, minus, moved, norm3, put, times
from ptnsbc_core.kernel import kernel
from ptnsbc_core.nullspace import projector
from ptnsbc_core.tasks import encounters as memory
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import AVOIDANCE_OFF, AVOIDANCE_SWITCHED, Array, ClearanceConfig

_SWEEPS = 60
_TOLERANCE = 1e-9
_COINCIDENT_M = 1e-6


class Demands(NamedTuple):
    """One row per near object: normal . v >= least."""

    normals: Array  # (M, 3) from the object to the UAV
    least: Array  # (M,) [m/s]
    depth: Array  # (M,) d_d - d [m], positive inside


class Clearance(NamedTuple):
    """The top-priority task at one tick."""

    velocity: Array  # (3,) J^+ of the binding demands [m/s]; zero without any
    jacobian: Array  # (A, 3) their normals
    below: Array  # (3,) velocity for the level below: the formation's, with circulation added
    encounters: Array  # memory after this tick


@kernel
def demands(
    position: Array,
    near: Array,
    age_s: float,
    encounters: Array,
    dt: float,
    config: ClearanceConfig,
) -> Demands:
    """Rows for the near objects (M, 7), moved on by their velocity since they were seen."""
    count = near.shape[0]
    normals = np.zeros((count, 3))
    least = np.full(count, -np.inf)
    depth = np.full(count, -np.inf)
    for m in range(count):
        centre = moved(near[m], age_s, near[m, 4:7])
        away = minus(position, centre)
        distance = norm3(away)
        if distance < _COINCIDENT_M:
            continue
        put(normals[m], 0, divided(away, distance))
        depth[m] = near[m, 3] + config.margin_m - distance
        alpha = config.gain.kappa
        if depth[m] > 0.0:
            since = memory.active_time(encounters, centre)
            alpha += step_gain(since, dt, config.gain.duration_s, config.gain.residual)
        least[m] = dot3(normals[m], near[m, 4:7]) + config.gain.scale * alpha * depth[m]
    return Demands(normals, least, depth)


@kernel
def nearest_admissible(velocity: Array, rows: Demands) -> Array:
    """Multipliers (M,) [m/s] of the admissible velocity nearest to `velocity` (3,), by Hildreth's sweeps.

    The admissible velocity is velocity + sum of multiplier * normal; a positive multiplier marks a demand
    that binds. Demands that contradict each other end at the sweep limit with the last compromise.
    """
    count = rows.least.shape[0]
    multipliers = np.zeros(count)
    v = velocity.copy()
    for _ in range(_SWEEPS):
        change = 0.0
        for m in range(count):
            lack = rows.least[m] - dot3(rows.normals[m], v)
            new = max(0.0, multipliers[m] + lack) if lack > -np.inf else 0.0
            step = new - multipliers[m]
            if step != 0.0:
                multipliers[m] = new
                change = max(change, abs(step))
                for i in range(3):
                    v[i] += step * rows.normals[m, i]
        if change < _TOLERANCE:
            break
    return multipliers


@kernel
def tangent(normal: Array) -> Array:
    """Unit vector along e_z x n (3,), or e_x x n where n is nearly vertical."""
    out = np.zeros(3)
    length = math.hypot(normal[0], normal[1])
    if length > 0.1:
        out[0], out[1] = -normal[1] / length, normal[0] / length
        return out
    length = math.hypot(normal[1], normal[2])
    out[1], out[2] = -normal[2] / length, normal[1] / length
    return out


@kernel
def _circulated(
    velocity: Array,
    rows: Demands,
    multipliers: Array,
    near: Array,
    encounters: Array,
    config: ClearanceConfig,
) -> Array:
    """Add to `velocity` a motion around what blocks it, in proportion to how much it blocks."""
    out = velocity.copy()
    for m in range(multipliers.shape[0]):
        if multipliers[m] <= 0.0:
            continue
        slot = memory.find(encounters, near[m, 0:3])
        if slot < 0:
            continue
        rise = min(encounters[slot, memory.ACTIVE_S] / config.ramp_s, 1.0)
        push = config.circulation * rise * multipliers[m] * encounters[slot, memory.SIDE]
        way = tangent(rows.normals[m])
        for i in range(3):
            out[i] += push * way[i]
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
            put(out[count], 0, rows.normals[m])
            count += 1
    return out


@kernel
def _velocity_of(jacobian: Array, admissible: Array) -> Array:
    """Part of the admissible velocity (3,) in the row space of the binding normals: J^+ least."""
    if jacobian.shape[0] == 0:
        return np.zeros(3)
    return minus(admissible, times(projector(jacobian), admissible))


@kernel
def set_based(
    position: Array,
    velocity: Array,
    near: Array,
    age_s: float,
    encounters: Array,
    dt: float,
    config: ClearanceConfig,
) -> Clearance:
    """Least change of the formation velocity (3,) that keeps clear of all near objects (M, 7)."""
    rows = demands(position, near, age_s, encounters, dt, config)
    multipliers = nearest_admissible(velocity, rows)
    side = np.zeros(multipliers.shape[0])
    for m in range(multipliers.shape[0]):
        if multipliers[m] > 0.0:
            side[m] = dot3(minus(velocity, near[m, 4:7]), tangent(rows.normals[m]))
    after = memory.update(encounters, near, multipliers, side, dt, config)
    below = velocity
    if memory.any_met(after):
        below = _circulated(velocity, rows, multipliers, near, after, config)
        multipliers = nearest_admissible(below, rows)
    admissible = below.copy()
    for m in range(multipliers.shape[0]):
        for i in range(3):
            admissible[i] += multipliers[m] * rows.normals[m, i]
    jacobian = _binding(rows, multipliers)
    return Clearance(_velocity_of(jacobian, admissible), jacobian, below, after)


@kernel
def switched(
    position: Array,
    velocity: Array,
    near: Array,
    age_s: float,
    encounters: Array,
    dt: float,
    config: ClearanceConfig,
) -> Clearance:
    """The paper's rule (36)-(38) for the object deepest inside its keep-out; (34) with (d_d - d) kept signed."""
    rows = demands(position, near, age_s, encounters, dt, config)
    deepest = -1
    for m in range(rows.depth.shape[0]):
        if rows.depth[m] > -np.inf and (deepest < 0 or rows.depth[m] > rows.depth[deepest]):
            deepest = m
    hits = np.zeros(rows.depth.shape[0])
    jacobian = np.empty((0, 3))
    out = np.zeros(3)
    inside = False
    if deepest >= 0:
        inside = rows.depth[deepest] > 0.0
        jacobian = np.empty((1, 3))
        put(jacobian[0], 0, rows.normals[deepest])
        if inside:
            hits[deepest] = 1.0
            for i in range(3):
                out[i] = rows.least[deepest] * rows.normals[deepest, i]
    after = memory.update(encounters, near, hits, np.zeros(hits.shape[0]), dt, config)
    if not inside:
        jacobian = np.empty((0, 3))
    return Clearance(out, jacobian, velocity, after)


@kernel
def clearance(
    position: Array,
    velocity: Array,
    near: Array,
    age_s: float,
    encounters: Array,
    dt: float,
    config: ClearanceConfig,
) -> Clearance:
    """The rule that the configuration names; without near objects nothing but the memory's ageing."""
    if config.rule == AVOIDANCE_OFF:
        return Clearance(np.zeros(3), np.empty((0, 3)), velocity, encounters)
    if config.rule == AVOIDANCE_SWITCHED:
        return switched(position, velocity, near, age_s, encounters, dt, config)
    return set_based(position, velocity, near, age_s, encounters, dt, config)
