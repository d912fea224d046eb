"""The paths of the UAVs, as the formation announces them: all fly to their slots by one time profile.

On the planned approach a UAV is at x = g + z (x_0 - g) beside the leader, with its slot g, see curves/turned.py. Its
velocity there is x_dot = -z_dot / z (g - x): where a UAV goes can be read from where it is and how fast it flies.

Positions [m] and velocities [m/s] are world ENU, docs/notes/clearance.md ("Told paths").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.algebra import load3, norm3, sub3
from ptnsbc_core.curves.turned import Factor, goal_factor, mean_factor, plus_scaled
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.timebase import h_rate
from ptnsbc_core.types import Array, Vector3

REACH = 3
"""Column of the slots: half of the distance to the next slot [m]."""

_LEAST_RATE = 1e-6


class ToldPaths(NamedTuple):
    """The paths of all UAVs, as one UAV knows them."""

    t: float  # since the epoch [s]
    duration_s: float  # of the planned approach; 0: nothing is planned
    leader_position: Vector3  # [m, ENU]
    leader_velocity: Vector3  # [m/s, ENU]
    slot: Vector3  # [m, ENU] of this UAV, relative to the leader
    slots: Array  # (N, 4) those of the others, and half of the distance to the next one [m]
    reach: float  # [m] half of the distance from the own slot to the next one
    turn: float  # [rad] of the planned approach


@inline_kernel
def _nearness(gap: float, reach: float) -> float:
    """1 up to half of the reach, 0 from the reach on."""
    return min(max(2.0 - 2.0 * gap / reach, 0.0), 1.0) if reach > 0.0 else 0.0


@inline_kernel
def _goal(told: ToldPaths, position: Vector3, velocity: Vector3, left: Factor) -> Vector3:
    """The end of the path of a UAV that flies so, relative to the leader."""
    place = sub3(position, told.leader_position)
    return plus_scaled(1.0, left, sub3(velocity, told.leader_velocity), place)


@kernel
def path_share(
    told: ToldPaths,
    own_position: Vector3,
    own_velocity: Vector3,
    position: Vector3,
    velocity: Vector3,
    horizon_s: float,
) -> Factor:
    """Part of the present relative velocity [1] that two UAVs have on average within the horizon.

    On their paths it is (z(t + H) - z(t)) / (H z_dot), no longer than 1. Off them, where one of the two does not
    fly towards a slot, it is 1. In between it is in proportion to how near their goals are to slots.
    """
    all_of_it = Factor(1.0, 0.0, 1.0)
    rate = h_rate(told.t / told.duration_s, told.duration_s) if told.duration_s > 0.0 else 0.0
    if rate < _LEAST_RATE:
        return all_of_it
    mean = mean_factor(told.turn, told.t, told.duration_s, horizon_s)
    if told.turn == 0.0 and mean.up >= 1.0:
        return all_of_it
    left = goal_factor(told.turn, told.t, told.duration_s)
    own = _goal(told, own_position, own_velocity, left)
    kept = _nearness(norm3(sub3(own, told.slot)), told.reach)
    if kept <= 0.0:
        return all_of_it
    goal = _goal(told, position, velocity, left)
    least, reach = np.inf, 0.0
    for row in range(told.slots.shape[0]):
        gap = norm3(sub3(goal, load3(told.slots[row], 0)))
        if gap < least:
            least, reach = gap, told.slots[row, REACH]
    kept *= _nearness(least, reach)
    up = 1.0 - kept * (1.0 - mean.up)
    if told.turn == 0.0:
        return Factor(up, 0.0, up)
    return Factor(1.0 - kept * (1.0 - mean.along), kept * mean.across, up)
