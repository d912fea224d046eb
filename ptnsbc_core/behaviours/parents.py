"""Several parents of one UAV as one: the weighted mean of what they give (docs/notes/chains.md, "Several parents").

A parent gives its state, moved to the slot of the first parent. The mean of these is the message of one parent in that
slot, and the laws take it as such.
"""

from __future__ import annotations

from ptnsbc_core.algebra import add3, axpy, load3, scale3, store3
from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import NEVER_RECEIVED_S, Array

_FULL, _NONE = 0.1, 0.5
"""Shares of stale_s: a parent whose message is older than the freshest by less than the first has all of its weight,
by more than the second none."""


@kernel
def mean_parent(
    states: Array, ages: Array, weights: Array, shifts: Array, stale_s: float, mean: Array
) -> float:
    """Write the mean message of the parents, with world axes as body axes, and return its age [s].

    The weight of a parent that is not heard goes to the others. Without any message the age is NEVER_RECEIVED_S.

    Args:
        states: (P, 13) newest odometry vectors of the parents.
        ages: (P,) their ages [s].
        weights: (P,) of the parents, positive.
        shifts: (P, 3) [m, ENU] from the slot of each parent to that of the first.
        stale_s: silence after which a UAV without another parent holds.
        mean: (13,) is overwritten.
    """
    position, velocity, zero = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    age, total, freshest = 0.0, 0.0, NEVER_RECEIVED_S
    for k in range(len(ages)):
        freshest = min(freshest, ages[k])
    for k in range(len(ages)):
        late = (ages[k] - freshest) / stale_s
        weight = weights[k] * min(max((_NONE - late) / (_NONE - _FULL), 0.0), 1.0)
        position = axpy(weight, add3(load3(states[k], 0), load3(shifts[k], 0)), position)
        velocity = axpy(weight, velocity_enu(states[k]), velocity)
        age += weight * ages[k]
        total += weight
    store3(mean, 0, scale3(1.0 / total, position))
    store3(mean, 3, zero)
    mean[6] = 1.0
    store3(mean, 7, scale3(1.0 / total, velocity))
    store3(mean, 10, zero)
    return age / total if freshest < NEVER_RECEIVED_S else NEVER_RECEIVED_S
