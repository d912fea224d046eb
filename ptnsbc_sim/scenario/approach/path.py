"""The path that the law plans for each UAV until the deadline, the turns that keep paths apart, and what a path asks.

In the world a UAV is planned at r - e + s - z E. The leader is e behind its trajectory r, by its law
e' = (1 - c) r' - G e from its start error (`ptnsbc_core.behaviours.mission`). The place s moves in from rest,
and z E is what is left of the start error E beside the leader (`ptnsbc_core.curves.turned`). Speed and acceleration
are differences of the samples.

Two UAVs are D - z E apart, with the differences D of their places and E of their start errors, and one z for all. So
the least planned distance of a pair follows from D, E and the turn. The leader is at the origin all the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.curves.turned import left_at
from ptnsbc_core.timebase import h, plan_duration
from ptnsbc_core.types import PROFILE_REFERENCE, PROFILE_SOFT, Array
from ptnsbc_sim.scenario.gains import gain_of
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.mission.trajectories import trajectory_of
from ptnsbc_sim.scenario.model import ScenarioFile

APART_M = 0.2
"""A planned pair is clear when it keeps so much more than its keep-out and the margin of the clearance."""

GRID_DEG = tuple(
    sign * degrees
    for first in (15.0, 7.5)
    for degrees in np.arange(first, 151.0, 15.0).tolist()
    for sign in (1, -1)
)
"""The turns that are tried: steps of 15 degrees and then those between, of each the smaller ones first.

A positive turn passes on the right, as avoidance does.
"""

_OF_ENDS = 0.85  # of its distance at start and end a pair keeps, where these are nearer than clear
_SAMPLES = 241


class ApproachPeaks(NamedTuple):
    """Largest speed and acceleration of a planned approach, for a start error of 1 m in 1 s."""

    speed: float  # [1]
    acceleration: float  # [1]


@lru_cache
def approach_peaks(turn: float) -> ApproachPeaks:
    """Peaks of |z_dot| and |z_ddot| for a turn [rad]; those of the vertical part are not above them."""
    if turn == 0.0:
        return ApproachPeaks(2.1875, 7.513)
    s = np.linspace(0.0, 1.0, 2001)
    rate = np.gradient(_left(turn, len(s)), s)
    change = np.gradient(rate, s)
    return ApproachPeaks(float(np.abs(rate).max()), float(np.abs(change).max()))


@lru_cache
def _left(turn: float, samples: int) -> Array:
    """z (T,) of the horizontal part at even shares of the duration."""
    factors = np.array([left_at(turn, s) for s in np.linspace(0.0, 1.0, samples).tolist()])
    return np.asarray(factors[:, 0] + 1j * factors[:, 1])


def rise(s: Array) -> Array:
    """h of every number of an array."""
    return np.array([h(one) for one in s.ravel().tolist()]).reshape(s.shape)


def left_of_start(turn: float, s: Array, error: Array) -> Array:
    """The rest (3, ...) [m] of a start error (3, ...) [m] at s = t / T (...) of a planned approach."""
    if turn == 0.0:
        return np.asarray((1.0 - rise(s)) * error)
    factors = np.array([left_at(turn, one) for one in s.ravel().tolist()])
    along, across, up = factors.T.reshape(3, *s.shape)
    x, y, z = error
    return np.stack([along * x - across * y, across * x + along * y, up * z])


class Pairs(NamedTuple):
    """All pairs of UAVs of a planned approach, beside the leader."""

    places: Array  # (P, 3) [m] difference of the places
    errors: Array  # (P, 3) [m] difference of the start errors
    clear: Array  # (P,) [m] distance from which the pair is clear


def pairs_of(starts: Array, places: Array, keep_outs: Array, margin_m: float) -> Pairs:
    """The pairs of UAVs, the leader among them, with starts and places (N, 3) [m] beside it and keep-outs (N,) [m]."""
    one, other = np.triu_indices(len(starts), 1)
    ends, begins = places[one] - places[other], starts[one] - starts[other]
    clear = 0.5 * (keep_outs[one] + keep_outs[other]) + margin_m + APART_M
    nearest = np.minimum(np.linalg.norm(begins, axis=1), np.linalg.norm(ends, axis=1))
    return Pairs(ends, ends - begins, np.minimum(clear, _OF_ENDS * nearest))


def distances(pairs: Pairs, turn: float) -> Array:
    """Least planned distance (P,) [m] of every pair."""
    ends = pairs.places[:, 0] + 1j * pairs.places[:, 1]
    errors = pairs.errors[:, 0] + 1j * pairs.errors[:, 1]
    factors = _left(turn, _SAMPLES)[:, None]
    across, up = ends - factors * errors, pairs.places[:, 2] - np.abs(factors) * pairs.errors[:, 2]
    squares = across.real**2 + across.imag**2 + up**2
    return np.asarray(np.sqrt(squares.min(axis=0)))


def candidates(pairs: Pairs) -> tuple[float, ...]:
    """Turns [rad], the one to take first: 0 where straight paths keep all pairs clear, and always at the end.

    Before it come the turns that keep all pairs clear, in the order of the grid. A turn that leaves one pair unclear is
    worse than none: avoidance takes turned paths for told, and resolves a meeting on straight ones better.
    """
    if _are_clear(pairs, 0.0):
        return (0.0,)
    turns = [math.radians(degrees) for degrees in GRID_DEG]
    return (*(turn for turn in turns if _are_clear(pairs, turn)), 0.0)


def _are_clear(pairs: Pairs, turn: float) -> bool:
    return bool(np.all(distances(pairs, turn) >= pairs.clear))


_SHORTER = 0.98  # from one deadline that is tried to the next
_AT_ONCE = 32
_ROUNDING = 1e-9


class EpochPlaces(NamedTuple):
    """The places of the UAVs at an epoch, and the slots that they take."""

    positions_m: Mapping[int, Array]  # (3,) by UAV, ENU
    slots: Mapping[int, int]  # by UAV
    begin_s: float  # the epoch, after the first one


def _errors_of_leader(
    file: ScenarioFile, start: Array, path: Array, t: Array, begin_s: float
) -> Array:
    """e (D, K, 3) [m] of the leader's law, from `start` (3,) along its trajectory (D, K, 3) at times (D, K)."""
    gain, duration = gain_of(file.gains, file.gains.formation), t[:, -1:]
    risen = rise(t / duration)
    if gain.profile == PROFILE_REFERENCE:
        return np.asarray((1.0 - risen)[..., None] * start)
    soft = gain.profile == PROFILE_SOFT
    onset = rise((t + begin_s) / duration) if soft else np.ones_like(t)
    middle = 0.5 * (onset[:, 1:] + onset[:, :-1])
    kept = np.exp(-gain.scale * gain.kappa * middle * np.diff(t))
    if math.isfinite(gain.residual):
        left = 1.0 - risen + gain.residual
        kept *= (left[:, 1:] / left[:, :-1]) ** gain.scale
    lost = ((1.0 - middle) * np.sqrt(kept))[..., None] * np.diff(path, axis=1)
    errors = np.empty_like(path)
    errors[:, 0] = start
    for k in range(t.shape[1] - 1):
        errors[:, k + 1] = kept[:, k, None] * errors[:, k] + lost[:, k]
    return errors


def plan_durations(file: ScenarioFile, deadlines: Array) -> Array:
    """Lengths (D,) [s] of the planned approach of followers."""
    if file.formation.approach == "task":
        return deadlines
    gain = gain_of(file.gains, file.gains.formation)
    return np.array([plan_duration(gain._replace(duration_s=one)) for one in deadlines.tolist()])


def planned_paths(
    file: ScenarioFile, starts: EpochPlaces, uav: int, deadlines: Array, turn: float
) -> tuple[Array, Array]:
    """Times (D, K) [s] since the epoch and positions (D, K, 3) [m, ENU] of a UAV, for deadlines (D,) [s]."""
    t = deadlines[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
    times, curve = (t + starts.begin_s).ravel(), trajectory_of(file.leader.trajectory)
    path = curve_samples(curve, times)[:, :3].reshape(*t.shape, 3)
    slot = starts.slots[uav]
    lead = next(one for one, taken in starts.slots.items() if taken == file.leader.id)
    behind = path[0, 0] - starts.positions_m[lead]
    path = path - _errors_of_leader(file, behind, path, t, starts.begin_s)
    if slot == file.leader.id:
        return t, path
    s = np.minimum(t / plan_durations(file, deadlines)[:, None], 1.0)
    place = places_beside_leader(file, slot, times).reshape(path.shape)
    if file.formation.moves and not starts.begin_s:
        place = place[:1, :1] + rise(s)[..., None] * (place - place[:1, :1])
    error = starts.positions_m[lead] + place[0, 0] - starts.positions_m[uav]
    return t, path + place - np.moveaxis(left_of_start(turn, s, error[:, None, None]), 0, -1)


def demands(
    file: ScenarioFile, starts: EpochPlaces, uav: int, deadlines: Array, turn: float
) -> Array:
    """Largest part (D,) of any limit that the planned path of a UAV takes, for deadlines (D,) [s]."""
    t, path = planned_paths(file, starts, uav, deadlines, turn)
    dt = (t[:, 1] - t[:, 0])[:, None, None]
    velocity = np.diff(path, axis=1) / dt
    acceleration = np.diff(velocity, axis=1) / dt
    plant, gravity = file.vehicle(uav), file.world.gravity_m_s2
    speed = np.linalg.norm(velocity, axis=2).max(axis=1) / file.max_speed_m_s(uav)
    rate = (
        np.linalg.norm(acceleration, axis=2).max(axis=1) / file.gains.filter.max_acceleration_m_s2
    )
    if plant.kind != "quadrotor" or plant.quadrotor is None:
        force = np.linalg.norm(acceleration + np.array([0.0, 0.0, gravity]), axis=2).max(axis=1)
        return np.max([speed, rate, force * plant.mass_kg / plant.rigid_body.max_force_n], axis=0)
    middle = 0.5 * (velocity[:, 1:] + velocity[:, :-1])
    force = acceleration + plant.quadrotor.drag_1_s * (middle - np.array(file.world.wind_m_s))
    force[..., 2] += gravity
    thrust = (
        np.linalg.norm(force, axis=2).max(axis=1) * plant.mass_kg / plant.quadrotor.max_thrust_n
    )
    lift = np.maximum(force[..., 2], _ROUNDING) * math.tan(plant.quadrotor.max_tilt_rad)
    tilt = (np.hypot(force[..., 0], force[..., 1]) / lift).max(axis=1)
    return np.max([speed, rate, thrust, tilt], axis=0)


def shortest_below(
    file: ScenarioFile, starts: EpochPlaces, uav: int, bound_s: float, turn: float
) -> float:
    """The shortest deadline [s] from which on, up to a bound, every one leaves the planned path within the limits.

    The bound itself where the path for the next shorter one is not.
    """
    shortest = bound_s
    while shortest > _ROUNDING and math.isfinite(shortest):
        tried = shortest * _SHORTER ** np.arange(1.0, _AT_ONCE + 1.0, dtype=np.float64)
        beyond = np.flatnonzero(demands(file, starts, uav, tried, turn) > 1.0 + _ROUNDING)
        if beyond.size:
            return float(tried[beyond[0] - 1]) if beyond[0] else shortest
        shortest = float(tried[-1])
    return shortest
