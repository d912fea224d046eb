"""Places of a formation that moves in itself: it turns with the leader's heading, or changes at mission times.

The place of a UAV beside the leader is s = R(psi + theta) a, where a is its place in the axes of the shape, theta the
turn of the shape, and psi the heading of the leader's trajectory. a and theta are piecewise polynomials of time, psi
comes from the trajectory, which every UAV knows. All derivatives are closed forms, so that they can be fed forward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import axpy, scale3, store3, sub3
from ptnsbc_core.curves.trajectory import Heading, curve_state, polynomial, row_at
from ptnsbc_core.kernel import formula, inline_kernel, kernel, prepared
from ptnsbc_core.timebase import h, h_rate
from ptnsbc_core.types import Array, Shape, Trajectory, Vector3

OWN, PARENT, TURN = 0, 3, 6
"""Channels of the table of a shape: the place of the UAV, that of its parent, and the turn of the shape."""

CHANNELS = 7


class PlaceMotion(NamedTuple):
    """Place beside the leader and its motion, in the axes of the world."""

    position: Vector3  # [m]
    velocity: Vector3  # [m/s]
    acceleration: Vector3  # [m/s^2]


class Places(NamedTuple):
    """The places of a UAV and its parent beside the leader."""

    own: PlaceMotion
    parent: PlaceMotion


@inline_kernel
def _angle(shape: Shape, trajectory: Trajectory, row: int, t: float) -> Heading:
    """Angle of the axes of the shape."""
    turn = polynomial(shape.table, row, TURN, t)
    if not shape.turns:
        return Heading(turn.value, turn.first, turn.second)
    with_leader = curve_state(trajectory, t).heading
    return Heading(
        turn.value + with_leader.angle,
        turn.first + with_leader.rate,
        turn.second + with_leader.acceleration,
    )


@formula
def _turned(vector: Vector3, sine: float, cosine: float) -> Vector3:
    return (
        cosine * vector[0] - sine * vector[1],
        sine * vector[0] + cosine * vector[1],
        vector[2],
    )


@formula
def _place(table: Array, row: int, channel: int, axes: Heading, t: float) -> PlaceMotion:
    """R a, R (a' + w J a) and R (a'' + 2 w J a' + w' J a - w^2 a), with J a quarter of a turn."""
    x, y = polynomial(table, row, channel, t), polynomial(table, row, channel + 1, t)
    z = polynomial(table, row, channel + 2, t)
    sine, cosine, rate = math.sin(axes.angle), math.cos(axes.angle), axes.rate
    velocity = (x.first - rate * y.value, y.first + rate * x.value, z.first)
    square = rate * rate
    acceleration = (
        x.second - 2.0 * rate * y.first - axes.acceleration * y.value - square * x.value,
        y.second + 2.0 * rate * x.first + axes.acceleration * x.value - square * y.value,
        z.second,
    )
    return PlaceMotion(
        _turned((x.value, y.value, z.value), sine, cosine),
        _turned(velocity, sine, cosine),
        _turned(acceleration, sine, cosine),
    )


@kernel
def places(shape: Shape, trajectory: Trajectory, t: float) -> Places:
    """The places at t [s] since the first epoch."""
    row = row_at(shape.table, t)
    axes = _angle(shape, trajectory, row, t)
    return Places(_place(shape.table, row, OWN, axes, t), _place(shape.table, row, PARENT, axes, t))


@formula
def _begun(now: PlaceMotion, first: Vector3, share: float, rate: float, bend: float) -> PlaceMotion:
    """s_0 + h (s - s_0) and its derivatives."""
    away = sub3(now.position, first)
    return PlaceMotion(
        axpy(share, away, first),
        axpy(rate, away, scale3(share, now.velocity)),
        axpy(bend, away, axpy(2.0 * rate, now.velocity, scale3(share, now.acceleration))),
    )


@kernel
def places_from_rest(shape: Shape, trajectory: Trajectory, duration_s: float, t: float) -> Places:
    """The places as they are flown: s_0 + h (s - s_0), from rest to s = `places` within `duration_s` [s]."""
    now = places(shape, trajectory, t)
    if t >= duration_s:
        return now
    first = places(shape, trajectory, 0.0)
    s = max(t / duration_s, 0.0)
    share, rate, left = h(s), h_rate(s, duration_s), s * (1.0 - s)
    bend = 420.0 * left * left * (1.0 - 2.0 * s) / (duration_s * duration_s)
    return Places(
        _begun(now.own, first.own.position, share, rate, bend),
        _begun(now.parent, first.parent.position, share, rate, bend),
    )


def place_samples(shape: Shape, trajectory: Trajectory, times: Array) -> Array:
    """Place, velocity and acceleration of a UAV beside the leader (T, 9), at times (T,) [s] since the first epoch."""
    given = (shape, trajectory, np.ascontiguousarray(times), np.empty((len(times), 9)))
    prepared(_sample, *given)(*given)
    return given[-1]


@kernel
def _sample(shape: Shape, trajectory: Trajectory, times: Array, out: Array) -> None:
    for k in range(times.shape[0]):
        own = places(shape, trajectory, times[k]).own
        store3(out[k], 0, own.position)
        store3(out[k], 3, own.velocity)
        store3(out[k], 6, own.acceleration)
