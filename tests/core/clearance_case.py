"""Clearance on arrays, and the configuration, objects and outputs that its tests share."""

import numpy as np
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core import nullspace
from ptnsbc_core.curves.turned import ToldPaths
from ptnsbc_core.tasks import clearance as task
from ptnsbc_core.tasks.near_constraints import ObstacleView, empty_memory
from ptnsbc_core.timebase import step_gain
from ptnsbc_core.types import (
    AVOIDANCE_SET_BASED,
    PROFILE_PAPER,
    SPEED_BRAKING,
    SPEED_LINEAR,
    ClearanceConfig,
    ClearanceTask,
    LoopGain,
    VelocityLoop,
)

clearance = on_arrays(task.clearance)
compose_with_clearance = on_arrays(nullspace.compose_with_clearance)

DT, KAPPA, KEEP_OUT, LAG = 0.01, 3.0, 1.5, 0.2
FREE = np.inf
FIRST = KAPPA + step_gain(0.0, DT, 1.0, 1e-2)
"""alpha of the first tick inside, where the encounter's time base has only begun to rise."""

NO_DRIFT = (0.0, 0.0, 0.0)
NOTHING_TOLD = ToldPaths(0.0, 0.0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, np.empty((0, 4)), 0.0, 0.0)

seeds = st.integers(0, 2**31)


def config_of(rule: int = AVOIDANCE_SET_BASED, **changes) -> ClearanceConfig:
    gain = LoopGain(1.0, 1e-2, 1.0, KAPPA, PROFILE_PAPER)
    linear = ClearanceConfig(
        rule,
        0.0,
        gain,
        0.0,
        0.5,
        1e9,
        1.0,
        SPEED_LINEAR,
        6.0,
        6.0,
        LAG,
        1.0 / LAG,
        VelocityLoop(1.0 / LAG, 0.0, 0.0),
        0.05,
        0.5,
        4.0,
        4.0,
        0.1,
    )
    return linear._replace(**changes)


def braking(**changes) -> ClearanceConfig:
    return config_of(approach=SPEED_BRAKING, **changes)


def object_at(
    centre, velocity=(0.0, 0.0, 0.0), keep_out: float = KEEP_OUT, above: float = 0.0
) -> np.ndarray:
    return np.array([*centre, keep_out, *velocity, above], dtype=float)


def result(
    position,
    wanted,
    near,
    config,
    memory=None,
    age: float = 0.0,
    velocity=(0.0, 0.0, 0.0),
    command=None,
    told=NOTHING_TOLD,
):
    """The clearance task and the composed velocity; without a command the UAV has the one it flies."""
    memory = empty_memory() if memory is None else memory
    velocity = np.asarray(velocity, dtype=float)
    command = velocity if command is None else np.asarray(command, dtype=float)
    view = ObstacleView(near, age, memory, DT, velocity, command, 0.0, LAG * velocity, told)
    top: ClearanceTask = clearance(position, wanted, view, config)
    return top, compose_with_clearance(top, FREE).velocity


ROCK = object_at((0.0, 0, 0))[np.newaxis]
"""One object that stands at the origin: (1, 8)."""
