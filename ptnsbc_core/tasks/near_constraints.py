"""The constraints n.v >= b that near objects put on the velocity of a UAV, (33)-(36), and the memory of these objects.

With d the distance, d_d the object's keep-out radius plus the own margin, and v_o its velocity, an object gives
(of an ellipsoid, in the space where it is a sphere, see signed_distance.py)

    linear     n.v >= n.v_o + alpha (d_d - d),  alpha = Lambda (kappa + Xi inside d_d), as (36)
    braking    the half space of velocities that can still be braked, docs/notes/clearance.md ("The bound")

The memory keeps for how long a constraint was binding, and on which side its object is passed. Near objects carry no
identity, so a slot belongs to the object nearest to its position. Rows (8, 7): x y z [m, ENU], side (+1 along e_z x n,
-1 against), time binding [s], time since it last was binding [s], used.

Positions [m] and velocities [m/s] are world ENU.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import add3, axpy, div3, dot3, load3, norm3, scale3, store3, sub3
from ptnsbc_core.curves.turned import ToldPaths, path_share, scaled
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.tasks.signed_distance import TANGENT_RADIUS_M, flattened, slope
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import SPEED_BRAKING, Array, ClearanceConfig, Vector3, Vector3Like

LATENCIES = 4.0
"""T per lag tau: the bound has the slope 1/T at the keep-out, and a lag tau overshoots for slopes above 1/(4 tau)."""

SHARE = 0.5
"""Part of a change of relative velocity that a UAV makes when the other one moves too."""

COMMON = 0.5
"""Part of the UAV's deviation from its command that it takes the other one to have as well."""

_ASIDE = 0.3
"""Tangent of the angle within which a straight meeting is passed on the common side."""

_TINY = 1e-9

ABOVE = 7
"""Column of a near object: half the height of its keep-out [m], where that is more than its radius."""

SLOTS = 8
SIDE, ACTIVE_S, QUIET_S, USED = 3, 4, 5, 6
MATCH_RADIUS_M = 1.0

_CHANGE = 0.25
"""The side changes from this share of timeout_s before it to the same share after it."""

_COINCIDENT_M = 1e-6
_LEAST_BRAKING = 0.25

_POINTS = 3
"""Of the way from the UAV to the line on which it ends, from which its velocities are judged."""

_SURE = 1e-3
"""Speed [m/s] and length [m] beyond which rounding does not count."""


class ObstacleView(NamedTuple):
    """The near objects that a UAV senses, and its memory of them."""

    near: Array  # (M, 8) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU] above [m]
    age_s: float  # of `near`, by which its objects are extrapolated
    memory: Array  # (8, 7) obstacle memory before this tick
    dt: float  # control period [s]
    velocity: Vector3  # [m/s, ENU] of the UAV
    command: Vector3  # [m/s, ENU] that it was given last, after the filter
    demand: float  # [m/s^2] acceleration that its motion needs already
    drift: Vector3  # [m, ENU] see `drift`
    told: ToldPaths  # of all UAVs of the formation


class ClearanceConstraint(NamedTuple):
    """Constraint of one near object: normal . v >= bound."""

    normal: Vector3  # away from the object
    bound: float  # [m/s], -inf where the two coincide
    depth: float  # d_d - d [m], positive inside


class ClearanceConstraints(NamedTuple):
    """One row per near object."""

    normals: Array  # (M, 3)
    bound: Array  # (M,) [m/s]
    depth: Array  # (M,) [m]


@inline_kernel
def empty_memory() -> Array:
    """An empty memory (8, 7)."""
    return np.zeros((SLOTS, 7))


@inline_kernel
def find_slot(memory: Array, centre: Vector3Like) -> int:
    """Used slot nearest to `centre` within MATCH_RADIUS_M, or -1."""
    nearest = -1
    least = MATCH_RADIUS_M * MATCH_RADIUS_M
    for slot in range(SLOTS):
        if memory[slot, USED] == 0.0:
            continue
        offset = sub3(memory[slot], centre)
        squared = dot3(offset, offset)
        if squared < least:
            least = squared
            nearest = slot
    return nearest


@inline_kernel
def any_used(memory: Array) -> bool:
    """True if any slot is in use."""
    used = 0.0
    for slot in range(SLOTS):
        used += memory[slot, USED]
    return used > 0.0


@kernel
def active_time(memory: Array, centre: Vector3) -> float:
    """The time for which the object at `centre` has been binding [s]; 0 for a new one."""
    slot = find_slot(memory, centre)
    if slot < 0:
        return 0.0
    return float(memory[slot, ACTIVE_S])


@inline_kernel
def side_of(memory: Array, slot: int, timeout_s: float) -> float:
    """Side on which an object is passed, -1 to 1: it changes around timeout_s, and again after another timeout_s.

    The change takes half of that time. A step would saturate the filter, and the tilt of the vehicle beside a slope
    would lead into it.
    """
    left = (timeout_s - memory[slot, ACTIVE_S]) / (_CHANGE * timeout_s)
    return memory[slot, SIDE] * min(max(left, -1.0), 1.0)


@kernel
def _claim_slot(memory: Array, side: float) -> int:
    """Take a free slot, or the one that was not binding for the longest time."""
    slot = 0
    for candidate in range(SLOTS):
        if memory[candidate, USED] == 0.0:
            slot = candidate
            break
        if memory[candidate, QUIET_S] > memory[slot, QUIET_S]:
            slot = candidate
    memory[slot, SIDE] = -1.0 if side < 0.0 else 1.0
    memory[slot, ACTIVE_S] = 0.0
    memory[slot, QUIET_S] = np.inf
    memory[slot, USED] = 1.0
    return slot


@kernel
def update_memory(
    memory: Array, near: Array, binding: Array, side: Array, dt: float, config: ClearanceConfig
) -> Array:
    """Memory after a tick in which the objects with a positive `binding` (M,) changed the velocity.

    A new object is passed on the side to which `side` (M,) points. After timeout_s the side changes, see `side_of`. A
    slot that was not binding for forget_s is free again.
    """
    out = memory.copy()
    for slot in range(SLOTS):
        if out[slot, USED] > 0.0:
            out[slot, QUIET_S] += dt
            if out[slot, QUIET_S] > config.forget_s:
                out[slot, USED] = 0.0
    for m in range(binding.shape[0]):
        if binding[m] <= 0.0:
            continue
        slot = find_slot(out, near[m])
        if slot < 0:
            slot = _claim_slot(out, side[m])
        store3(out[slot], 0, near[m])
        if out[slot, QUIET_S] > 0.0:  # once per tick, also when two near objects share the slot
            out[slot, ACTIVE_S] += dt
        out[slot, QUIET_S] = 0.0
        if out[slot, ACTIVE_S] > (1.0 + _CHANGE) * config.timeout_s:
            out[slot, SIDE] = -out[slot, SIDE]
            out[slot, ACTIVE_S] -= config.timeout_s
    return out


@inline_kernel
def braking_speed(room: float, deceleration: float, latency_s: float) -> float:
    """Largest closing speed [m/s] at `room` [m] >= 0: sqrt((a T)^2 + 2 a room) - a T."""
    lost = deceleration * latency_s
    return 2.0 * deceleration * room / (math.sqrt(lost * lost + 2.0 * deceleration * room) + lost)


@kernel
def tangent(normal: Vector3Like) -> Vector3:
    """Unit vector along e_z x n, or e_x x n where n is nearly vertical."""
    length = math.hypot(normal[0], normal[1])
    if length > 0.1:
        return -normal[1] / length, normal[0] / length, 0.0
    length = math.hypot(normal[1], normal[2])
    return 0.0, -normal[2] / length, normal[1] / length


class HalfSpace(NamedTuple):
    """normal . v >= bound."""

    normal: Vector3
    bound: float  # [m/s]


@kernel
def clear_velocities(
    away: Vector3, keep_out: float, relative: Vector3, allowed: float
) -> HalfSpace:
    """Relative velocities that stay clear of a sphere, linearised at the present one.

    The velocities that enter the sphere within the braking horizon room / allowed are a cone with a spherical
    tip, whose nearest point is `allowed` away from rest. The half space touches it where it is nearest to the
    present relative velocity. On a straight meeting that is beside the object, on the right-hand side: both
    UAVs of a pair choose the same sense of rotation.

    Args:
        away: (3,) from the object to the UAV [m], longer than `keep_out`.
        keep_out: radius of the sphere [m].
        relative: (3,) velocity of the UAV beside that of the object [m/s].
        allowed: closing speed straight to the object [m/s], above 0.
    """
    distance = norm3(away)
    rate = allowed / (distance - keep_out)  # 1 / horizon
    ahead = scale3(-1.0, away)
    toward = scale3(rate, ahead)
    normal = div3(away, distance)
    offset = sub3(relative, toward)
    along = dot3(offset, ahead)
    length = norm3(offset)
    if along < 0.0 and along * along > keep_out * keep_out * length * length:
        side = div3(offset, length)  # beside the tip
        return HalfSpace(side, dot3(side, toward) + keep_out * rate)
    closing = dot3(relative, ahead) / distance
    lateral = axpy(closing, normal, relative)
    lateral = axpy(_ASIDE * max(closing, 0.0), tangent(normal), lateral)
    across = norm3(lateral)
    lateral = div3(lateral, across) if across > _TINY else tangent(normal)
    sine = keep_out / distance
    side = add3(
        scale3(math.sqrt(1.0 - sine * sine), lateral), scale3(sine, normal)
    )  # outward normal of the cone
    return HalfSpace(side, 0.0)


@inline_kernel
def is_stale(view: ObstacleView, config: ClearanceConfig) -> bool:
    """True if the near-object sensor has been silent for longer than it may."""
    return view.age_s > config.stale_s


@inline_kernel
def _present(
    position: Vector3, near: Array, view: ObstacleView, config: ClearanceConfig
) -> tuple[Vector3, Vector3]:
    """Centre and velocity of an object, extrapolated to the present.

    Of one that has not been seen for too long nobody knows how far it went: it is the nearest point of its way.
    """
    velocity = load3(near, 4)
    if is_stale(view, config):
        way = scale3(view.age_s, velocity)
        length = dot3(way, way)
        if length > 0.0:
            share = min(max(dot3(sub3(position, load3(near, 0)), way) / length, 0.0), 1.0)
            return axpy(share, way, near), scale3(share, velocity)
    return axpy(view.age_s, velocity, near), velocity


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
def _flat(near: Array, margin_m: float) -> float:
    """Width over height of the keep-out of a near object and the margin around it; 1 for a sphere."""
    radius = max(near[3], 0.0)
    return (radius + margin_m) / (max(near[ABOVE], radius) + margin_m)


@inline_kernel
def constraint(
    position: Vector3, which: int, view: ObstacleView, straight: bool, config: ClearanceConfig
) -> ClearanceConstraint:
    """Constraint of the near object in row `which`; `straight`: whatever the told paths are."""
    near = view.near[which]
    centre, velocity = _present(position, near, view, config)
    flat = _flat(near, config.margin_m)
    away = flattened(sub3(position, centre), flat)
    distance = norm3(away)
    if distance < _COINCIDENT_M:
        return ClearanceConstraint((0.0, 0.0, 0.0), -np.inf, -np.inf)
    normal, rate = slope(div3(away, distance), flat)
    keep_out = max(near[3], 0.0) + config.margin_m
    depth = keep_out - distance
    if config.approach == SPEED_BRAKING and depth < -_COINCIDENT_M:
        ellipsoid = (keep_out, flat, rate)
        return _braking_constraint(position, centre, velocity, ellipsoid, view, straight, config)
    alpha = config.gain.kappa
    if depth > 0.0:
        since = active_time(view.memory, _landmark(near, centre, normal))
        alpha += step_gain(since, view.dt, config.gain.duration_s, config.gain.residual)
    return ClearanceConstraint(
        normal, dot3(normal, velocity) + config.gain.scale * alpha * depth / rate, depth
    )


@inline_kernel
def surely_kept(
    position: Vector3, velocity: Vector3, which: int, view: ObstacleView, config: ClearanceConfig
) -> bool:
    """True if `velocity` keeps the constraint of a near object, on straight paths, by its distance alone.

    A braking constraint leaves all relative velocities below `braking_speed`. The present one, and what `velocity` adds
    over the UAV's share, are below it where the room is long enough.
    """
    near, moving = view.near[which], load3(view.near[which], 4)
    braking = max(config.weakest - view.demand, _LEAST_BRAKING * config.weakest)
    if config.approach != SPEED_BRAKING or is_stale(view, config) or near[ABOVE] > near[3]:
        return False
    asked = norm3(sub3(velocity, view.velocity)) + COMMON * norm3(sub3(view.command, view.velocity))
    speed = norm3(sub3(view.velocity, moving)) + asked / SHARE + _SURE
    late = config.lag_s + max(view.age_s, config.sensor_s)
    room = speed * (LATENCIES * late + 0.5 * speed / max(braking, _TINY))
    reach = max(near[3], 0.0) + config.margin_m + max(room, norm3(view.drift) + _SURE)
    away = sub3(position, axpy(view.age_s, moving, near))
    return dot3(away, away) > reach * reach


@inline_kernel
def _lacks(space: HalfSpace, relative: Vector3) -> float:
    """The change [m/s] that a velocity needs to be in a half space."""
    return space.bound - dot3(space.normal, relative)


@inline_kernel
def drift(
    velocity: Vector3, command: Vector3, acceleration: Vector3, config: ClearanceConfig
) -> Vector3:
    """p [m] = u/b + (v - f u + t v')/K, of the velocity v, its rate, and the command u after the filter of bandwidth b.

    A vehicle with this VelocityLoop that is told w from here on ends on the line x + p + s w, whatever w is.
    """
    loop = config.loop
    behind = axpy(-loop.fed_forward, command, axpy(loop.attitude_s, acceleration, velocity))
    return axpy(1.0 / config.bandwidth, command, scale3(1.0 / loop.gain, behind))


@inline_kernel
def _leaving(
    away: Vector3, keep_out: float, relative: Vector3, allowed: float, lag_s: float
) -> HalfSpace:
    """`clear_velocities` from a point that the UAV comes to; where that is inside, those that lead out in its lag."""
    distance = norm3(away)
    if distance > keep_out + _COINCIDENT_M:
        return clear_velocities(away, keep_out, relative, allowed)
    if distance < _COINCIDENT_M:
        return HalfSpace((0.0, 0.0, 0.0), -np.inf)
    return HalfSpace(div3(away, distance), (keep_out - distance) / lag_s)


@kernel
def _braking_constraint(
    position: Vector3,
    centre: Vector3,
    velocity: Vector3,
    ellipsoid: Vector3,
    view: ObstacleView,
    straight: bool,
    config: ClearanceConfig,
) -> ClearanceConstraint:
    """Outside: the UAV's share of the least change of the relative velocity that does not end in the keep-out.

    An object that stands still changes nothing: the UAV makes all of the change. One that moves may be another
    UAV, which makes the other half. Each makes it beside the velocity that the pair is about to have, see
    docs/notes/clearance.md ("Shares"). One that moves may also be the weakest UAV: both of the pair count on what that
    one has. Of the deceleration at least a quarter remains.

    `ellipsoid`: radius [m] of the keep-out, `flat`, and the rate by which the distance grows now, see `slope`.
    """
    keep_out, flat, rate = ellipsoid
    away, relative = flattened(sub3(position, centre), flat), sub3(view.velocity, velocity)
    moves = dot3(velocity, velocity) > 0.0
    late, share, most, beside = config.lag_s, 1.0, config.deceleration, view.velocity
    if moves:
        late, share, most = config.lag_s + max(view.age_s, config.sensor_s), SHARE, config.weakest
        beside = axpy(COMMON, sub3(view.command, view.velocity), view.velocity)
    depth = keep_out - norm3(away)
    left = max(most - view.demand, _LEAST_BRAKING * most)
    allowed = braking_speed(-depth, rate * left, LATENCIES * late)
    if moves and not straight:
        horizon_s = -depth / allowed
        part = path_share(view.told, position, view.velocity, centre, velocity, horizon_s)
        relative = scaled(part, relative)
    closing_in = flattened(relative, flat)
    space = clear_velocities(away, keep_out, closing_in, allowed)
    if not moves and keep_out < TANGENT_RADIUS_M:  # the sphere of a body goes along with the UAV
        way = flattened(view.drift, flat)
        for point in range(1, _POINTS):
            later = axpy(point / (_POINTS - 1), way, away)
            later_space = _leaving(later, keep_out, closing_in, allowed, late)
            if _lacks(later_space, closing_in) > _lacks(space, closing_in):
                space = later_space
    side, steep = slope(space.normal, flat)
    bound = dot3(side, beside) + share * (space.bound / steep - dot3(side, relative))
    return ClearanceConstraint(side, bound, depth)


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
        row = constraint(position, m, view, False, config)
        store3(normals[m], 0, row.normal)
        bound[m] = row.bound
        depth[m] = row.depth
    return ClearanceConstraints(normals, bound, depth)
