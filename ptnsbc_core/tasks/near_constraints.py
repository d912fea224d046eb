"""The constraints n.v >= b that near objects put on the velocity of a UAV, (33)-(36), see docs/method.md.

The approach speed is `braking`, see approach.py, or `linear`: n.v >= n.v_o - alpha (d - d_d), as in (36).

Positions [m] and velocities [m/s] are world ENU; d_d is the object's keep-out radius plus the own margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, div3, dot3, load3, norm3, scale3, store3, sub3
from ptnsbc_core.curves.turned import scaled
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.tasks import obstacle_memory
from ptnsbc_core.tasks.approach import COMMON, LATENCIES, SHARE, braking_speed, clear_velocities
from ptnsbc_core.tasks.signed_distance import TANGENT_RADIUS_M
from ptnsbc_core.tasks.told_path import ToldPaths, path_share
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import SPEED_BRAKING, Array, ClearanceConfig, Vector3, Vector3Like

_COINCIDENT_M = 1e-6
_LEAST_BRAKING = 0.25


class ObstacleView(NamedTuple):
    """The near objects that a UAV senses, and its memory of them."""

    near: Array  # (M, 7) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU]
    age_s: float  # of `near`, by which its objects are extrapolated
    memory: Array  # (8, 7) obstacle memory before this tick
    dt: float  # control period [s]
    velocity: Vector3  # [m/s, ENU] of the UAV
    command: Vector3  # [m/s, ENU] that it was given last, after the filter
    demand: float  # [m/s^2] acceleration that its motion needs already
    told: ToldPaths  # of all UAVs of the formation


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
def is_stale(view: ObstacleView, config: ClearanceConfig) -> bool:
    """True if the near-object sensor has been silent for longer than it may."""
    return view.age_s > config.stale_s


@inline_kernel
def _deceleration(view: ObstacleView, moves: bool, config: ClearanceConfig) -> float:
    """The remaining deceleration [m/s^2], at least a quarter.

    An object that moves may be the weakest UAV: then both of the pair count on what that one has.
    """
    most = config.weakest if moves else config.deceleration
    return max(most - view.demand, _LEAST_BRAKING * most)


class _Sight(NamedTuple):
    """The place of an object by now, as far as it is known."""

    centre: Vector3  # [m, ENU]
    velocity: Vector3  # [m/s, ENU]


@inline_kernel
def _sight(position: Vector3, near: Array, view: ObstacleView, config: ClearanceConfig) -> _Sight:
    """The object extrapolated to the present.

    Of one that has not been seen for too long nobody knows how far it went: it is the nearest point of its way.
    """
    velocity = load3(near, 4)
    if is_stale(view, config):
        way = scale3(view.age_s, velocity)
        length = dot3(way, way)
        if length > 0.0:
            share = min(max(dot3(sub3(position, load3(near, 0)), way) / length, 0.0), 1.0)
            return _Sight(axpy(share, way, near), scale3(share, velocity))
    return _Sight(axpy(view.age_s, velocity, near), velocity)


@inline_kernel
def _landmark(near: Array, centre: Vector3Like, normal: Vector3Like) -> Vector3:
    """The point by which the memory knows an object: its centre, or where the sphere of a body touches the keep-out.

    The centre of such a sphere jumps where the body is round or has an edge.
    """
    reach = near[3] if near[3] >= TANGENT_RADIUS_M else 0.0
    return axpy(reach, normal, centre) if reach > 0.0 else load3(centre, 0)


@kernel
def landmarks_of(near: Array, normals: Array) -> Array:
    """The landmarks (M, 3) [m] of all near objects."""
    out = np.empty((near.shape[0], 3))
    for m in range(near.shape[0]):
        store3(out[m], 0, _landmark(near[m], load3(near[m], 0), normals[m]))
    return out


@inline_kernel
def constraint(
    position: Vector3, which: int, view: ObstacleView, straight: bool, config: ClearanceConfig
) -> ClearanceConstraint:
    """Constraint of the near object in row `which`; `straight`: whatever the told paths are."""
    near = view.near[which]
    sight = _sight(position, near, view, config)
    centre, velocity = sight.centre, sight.velocity
    away = sub3(position, centre)
    distance = norm3(away)
    if distance < _COINCIDENT_M:
        return ClearanceConstraint((0.0, 0.0, 0.0), -np.inf, -np.inf)
    normal = div3(away, distance)
    keep_out = max(near[3], 0.0) + config.margin_m
    depth = keep_out - distance
    if config.approach == SPEED_BRAKING and depth < -_COINCIDENT_M:
        return _braking_constraint(position, sight, keep_out, view, straight, config)
    alpha = config.gain.kappa
    if depth > 0.0:
        since = obstacle_memory.active_time(view.memory, _landmark(near, centre, normal))
        alpha += step_gain(since, view.dt, config.gain.duration_s, config.gain.residual)
    return ClearanceConstraint(
        normal, dot3(normal, velocity) + config.gain.scale * alpha * depth, depth
    )


@kernel
def _braking_constraint(
    position: Vector3,
    sight: _Sight,
    keep_out: float,
    view: ObstacleView,
    straight: bool,
    config: ClearanceConfig,
) -> ClearanceConstraint:
    """Outside: the UAV's share of the least change of the relative velocity that does not end in the keep-out.

    An object that stands still changes nothing: the UAV makes all of the change. One that moves may be another
    UAV, which makes the other half. Each makes it beside the velocity that the pair is about to have, see
    docs/notes/clearance.md ("Shares").
    """
    velocity = sight.velocity
    away = sub3(position, sight.centre)
    moves = dot3(velocity, velocity) > 0.0
    late = config.lag_s + (max(view.age_s, config.sensor_s) if moves else 0.0)
    alone = not moves
    share = 1.0 if alone else SHARE
    depth = keep_out - norm3(away)
    allowed = braking_speed(-depth, _deceleration(view, moves, config), LATENCIES * late)
    relative = sub3(view.velocity, velocity)
    if moves and not straight:
        part = path_share(
            view.told, position, view.velocity, sight.centre, velocity, -depth / allowed
        )
        relative = scaled(part, relative)
    space = clear_velocities(away, keep_out, relative, allowed)
    beside = view.velocity
    if not alone:
        beside = axpy(COMMON, sub3(view.command, view.velocity), view.velocity)
    bound = dot3(space.normal, beside) + share * (space.bound - dot3(space.normal, relative))
    return ClearanceConstraint(space.normal, bound, depth)


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
        one = constraint(position, m, view, False, config)
        store3(normals[m], 0, one.normal)
        bound[m] = one.bound
        depth[m] = one.depth
    return ClearanceConstraints(normals, bound, depth)
