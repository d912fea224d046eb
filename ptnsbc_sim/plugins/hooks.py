"""The hooks for plug-ins: with what each is called, and what it gives. docs/laws.md says in the place of what.

A scenario names a plug-in as `FILE.py:NAME`, or as the name of an entry point `HOOK.NAME` in `ptnsbc.plugins`. It is a
pure function of its inputs: its random numbers and the memory of a law are in them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import NEAR_COLUMNS, ODOMETRY_SIZE, Array, Vector3
from ptnsbc_sim.plants.contract import STATE_SIZE

SAMPLES = 6
"""Random numbers that a disturbance and a sensor get at each call."""


# Kernels (`ptnsbc_core.kernel`) make it: the digest of their sources has to count this file.
class LawInputs(NamedTuple):
    """The input of a law at one tick; positions and velocities are ENU. K: senders heard, M: objects near."""

    t: float  # [s] since the epoch
    position: Array  # (3,) own [m]
    velocity: Array  # (3,) own [m/s]
    offset: Array  # (3,) own place relative to the leader [m]
    offset_velocity: Array  # (3,) of this place [m/s], where the shape moves
    ids: NDArray[np.int64]  # (K,) parent, leader where it is heard, neighbours; ascending
    positions: Array  # (K, 3) of the senders [m]
    velocities: Array  # (K, 3) that they command [m/s]
    offsets: Array  # (K, 3) their places relative to the leader [m]
    offset_velocities: Array  # (K, 3) of these places [m/s]
    ages_s: Array  # (K,) ages of what they sent
    near: Array  # (M, 8) objects near: x y z [m], keep-out radius [m], vx vy vz [m/s], above [m]
    deadline_s: float  # of the formation, counted from the epoch
    max_speed_m_s: float  # to which the command is limited
    memory: Array  # (M,) what the law gave beside its velocity at the tick before


class ControllerInputs(NamedTuple):
    """The input of a controller at one tick."""

    t: float  # [s] since the epoch
    dt: float  # [s] control period
    odometry: Array  # (13,) position [m, ENU], quaternion x y z w, velocity [m/s] and rates [rad/s] of the body
    velocity: Array  # (3,) commanded [m/s, ENU]
    yaw_rate: float  # commanded [rad/s]
    wrench: Array  # (6,) force [N] and torque [N m] of our controller, body FLU
    mass: float  # [kg] that the laws know
    inertia: Array  # (3,) [kg m^2] that the laws know
    gravity: float  # [m/s^2]


class PlantInputs(NamedTuple):
    """The input of a plant at an instant."""

    t: float  # [s] of the simulated world
    state: Array  # (17,) position, quaternion x y z w, velocity [ENU], body rates, four numbers of its own
    wrench: Array  # (6,) commanded force [N] and torque [N m], body FLU
    push: Array  # (6,) acceleration of the disturbances [m/s^2, ENU], [rad/s^2, body]
    wind: Array  # (3,) [m/s, ENU]
    mass: float  # [kg] true
    inertia: Array  # (3,) [kg m^2] true
    gravity: float  # [m/s^2]
    max_thrust: float  # [N]
    max_torque: Array  # (3,) [N m]
    motor_lag_s: float
    drag: float  # [1/s]


class DisturbanceInputs(NamedTuple):
    """The input of a disturbance at the start of a control period; `odometry` as in ControllerInputs."""

    t: float  # [s] of the simulated world
    uav: int  # id
    odometry: Array  # (13,) true
    samples: Array  # (6,) standard normal numbers of this UAV and tick, from the scenario's seed


class SensorInputs(NamedTuple):
    """The input of a near-object sensor at a reading. M: all other UAVs and all obstacles, at any distance."""

    t: float  # [s] of the simulated world
    uav: int  # id
    odometry: Array  # (13,) true
    objects: Array  # (M, 8) x y z [m], keep-out radius [m], vx vy vz [m/s, ENU], above [m]
    range_m: float  # of the scenario
    samples: Array  # (6,) standard normal numbers of this UAV and reading


class Hook(NamedTuple):
    """A place where a function of the user is called."""

    name: str
    example: Sequence[Any]  # arguments of the types of all calls
    gives: str
    size: int  # how many numbers it gives; 0: rows, any number of them


def _example(inputs: Callable[..., Any], **shapes: int | tuple[int, int]) -> tuple[Any]:
    """Inputs of the types of all calls; an array whose shape is not given has three numbers."""
    example: list[Any] = []
    for name, hint in get_type_hints(inputs).items():
        if hint in (float, int):
            example.append(hint(1))
        else:
            kind = np.int64 if "int64" in str(hint) else np.float64
            example.append(np.ones(shapes.get(name, 3), dtype=kind))
    return (inputs(*example),)


_POINT: Vector3 = (0.0, 0.0, 0.0)
_ROWS, _NEAR = (1, 3), (1, NEAR_COLUMNS)
_SENDERS = dict.fromkeys(("positions", "velocities", "offsets", "offset_velocities"), _ROWS)
_LAW = _example(LawInputs, ids=1, ages_s=1, near=_NEAR, memory=0, **_SENDERS)
_CONTROLLER = _example(ControllerInputs, odometry=ODOMETRY_SIZE, wrench=6)
_PLANT = _example(PlantInputs, state=STATE_SIZE, wrench=6, push=6)
_DISTURBANCE = _example(DisturbanceInputs, odometry=ODOMETRY_SIZE, samples=SAMPLES)
_SENSOR = _example(SensorInputs, odometry=ODOMETRY_SIZE, objects=_NEAR, samples=SAMPLES)

HOOKS = {
    hook.name: hook
    for hook in (
        Hook("law", _LAW, "a velocity of three numbers [m/s, ENU]", 3),
        Hook("task", (_POINT, _POINT, _POINT), "three numbers, the value of the task", 3),
        Hook(
            "controller",
            _CONTROLLER,
            "force [N] and torque [N m], six numbers in the body frame (FLU)",
            6,
        ),
        Hook("plant", _PLANT, "17 numbers, d state / dt", STATE_SIZE),
        Hook(
            "disturbance",
            _DISTURBANCE,
            "six numbers: acceleration [m/s^2, ENU] and angular acceleration [rad/s^2, body]",
            6,
        ),
        Hook("sensor", _SENSOR, f"rows of {NEAR_COLUMNS} finite numbers", 0),
    )
}
"""All hooks that are called in flight, by their names in a scenario."""
