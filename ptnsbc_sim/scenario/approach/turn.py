"""The turns of the planned approach that keep pairs of UAVs apart, by starts and places alone.

Beside the leader a UAV is planned at g - z E_0, with its place g, its start error E_0 and one z for all UAVs
(ptnsbc_core.curves.turned). Two UAVs are then D - z E apart, with the differences D and E of both. So the least planned
distance of a pair follows from D, E and the turn. The leader is at the origin all the time.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.turned import left_at
from ptnsbc_core.timebase import h
from ptnsbc_core.types import Array

APART_M = 0.2
"""A planned pair is clear when it keeps so much more than its keep-out and the margin of the clearance."""

GRID_DEG = tuple(sign * degrees for degrees in range(15, 121, 15) for sign in (1, -1))
"""The turns that are tried, the smaller ones first. A positive turn passes on the right, as avoidance does."""

_OF_ENDS = (
    0.85  # what a pair keeps of its distance at start and end, where these are nearer than clear
)
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
    rate = np.gradient(_left(turn, s), s)
    change = np.gradient(rate, s)
    return ApproachPeaks(float(np.abs(rate).max()), float(np.abs(change).max()))


def _left(turn: float, s: Array) -> Array:
    """z (T,) of the horizontal part at s = t / T."""
    factors = np.array([left_at(turn, one) for one in s.tolist()])
    return np.asarray(factors[:, 0] + 1j * factors[:, 1])


@lru_cache
def _shares(turn: float) -> Array:
    return _left(turn, np.linspace(0.0, 1.0, _SAMPLES))


def rise(s: Array) -> Array:
    """h of every number of an array."""
    return np.array([h(one) for one in s.ravel().tolist()]).reshape(s.shape)


def left_of_start(turn: float, s: Array, error: Array) -> Array:
    """The rest (..., 3) [m] of a start error (3,) [m] at s = t / T (...) of a planned approach."""
    if turn == 0.0:
        return np.asarray((1.0 - rise(s))[..., None] * error)
    factors = np.array([left_at(turn, one) for one in s.ravel().tolist()])
    along, across, up = factors.T.reshape(3, *s.shape)
    x, y, z = error
    return np.stack([along * x - across * y, across * x + along * y, up * z], axis=-1)


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
    z = _shares(turn)
    ends = pairs.places[:, 0] + 1j * pairs.places[:, 1]
    errors = pairs.errors[:, 0] + 1j * pairs.errors[:, 1]
    least = np.full(len(ends), np.inf)
    for factor in z:
        flat = np.abs(ends - factor * errors)
        up = pairs.places[:, 2] - abs(factor) * pairs.errors[:, 2]
        least = np.minimum(least, np.hypot(flat, up))
    return least


def candidates(pairs: Pairs) -> tuple[float, ...]:
    """Turns [rad], the one to take first: 0 where straight paths keep all pairs clear, and always at the end.

    Before it come the turns that keep all pairs clear, the smallest first. A turn that leaves one pair unclear is worse
    than none: avoidance takes turned paths for told, and resolves a meeting on straight ones better.
    """
    if _are_clear(pairs, 0.0):
        return (0.0,)
    turns = [math.radians(degrees) for degrees in GRID_DEG]
    return (*(turn for turn in turns if _are_clear(pairs, turn)), 0.0)


def _are_clear(pairs: Pairs, turn: float) -> bool:
    return bool(np.all(distances(pairs, turn) >= pairs.clear))
