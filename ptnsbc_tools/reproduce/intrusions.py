"""How a UAV got into a keep-out: into whose, how fast it was told to go in, and how far that carries it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.track import PRIORITY_VIOLATION, SINGULAR_VALUE
from ptnsbc_tools.reproduce.flights import JudgedFlight

BEFORE_S = 4.0  # how long before it goes in the formation task is looked at


class Intrusion(NamedTuple):
    """The moment of a flight at which a UAV was closest to an object, less the object's keep-out."""

    uav: int
    into: str
    at_s: float
    room_m: float  # negative inside
    told_m_s: float  # commanded speed towards the object when it went in; positive is in
    went_m_s: float  # its own
    stopping_m: (
        float  # what turning that command round costs at the command filter's largest acceleration
    )
    singular_value: float  # smallest of the formation task in the seconds before
    priority_violation_m_s: (
        float  # largest since it went in: what the formation took from the avoidance
    )


class _Object(NamedTuple):
    """Something with a keep-out, over time."""

    name: str
    row: int | None  # of a UAV
    places: Array  # (T, 3) [m]
    keep_out_m: float


def _objects(one: JudgedFlight) -> Iterator[_Object]:
    for obstacle in one.scenario.obstacles:
        places = np.broadcast_to(obstacle.position, one.positions[:, 0].shape)
        yield _Object(obstacle.name, None, places, obstacle.keep_out_m)
    keep_out_m = one.scenario.uav_keep_out_m
    for row, uav in enumerate(one.scenario.uav_ids):
        yield _Object(f"UAV {uav}", row, one.positions[:, row], keep_out_m)


def deepest(one: JudgedFlight) -> Intrusion:
    """The deepest of a flight."""
    found = [
        _seen(one, row, thing)
        for row in range(len(one.scenario.uav_ids))
        for thing in _objects(one)
        if thing.row is None or thing.row > row
    ]
    return min(found, key=lambda intrusion: intrusion.room_m)


def _seen(one: JudgedFlight, row: int, thing: _Object) -> Intrusion:
    """The closest moment of one UAV and one object."""
    away = one.positions[:, row] - thing.places
    distance = np.linalg.norm(away, axis=1)
    room = distance - thing.keep_out_m
    last = int(room.argmin())
    outside = np.flatnonzero(room[: last + 1] > 0.0)
    first = int(outside[-1]) if outside.size else 0
    normal = away[first] / distance[first]
    dt = one.scenario.dt_ns * 1e-9
    still = _velocity(thing.places, first, dt)
    told = float(normal @ (still - one.flight.track.velocity[first, row, :3]))
    went = float(normal @ (still - _velocity(one.positions[:, row], first, dt)))
    log = one.flight.track.diagnostics[:, row]
    since = max(0, first - round(BEFORE_S / dt))
    limit = one.scenario.gains.filter.max_acceleration_m_s2
    return Intrusion(
        one.scenario.uav_ids[row],
        thing.name,
        float(one.times[last]),
        float(room[last]),
        told,
        went,
        max(told, 0.0) ** 2 / (2.0 * limit),
        float(log[since : first + 1, SINGULAR_VALUE].min()),
        float(log[first : last + 1, PRIORITY_VIOLATION].max()),
    )


def _velocity(places: Array, tick: int, dt: float) -> Array:
    """(3,) [m/s] of what moves along `places` (T, 3)."""
    before, after = max(tick - 1, 0), min(tick + 1, len(places) - 1)
    return np.asarray((places[after] - places[before]) / ((after - before) * dt))
