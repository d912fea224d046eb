"""Controllers of the user: one function that gives force and torque from the vehicle's state and its command."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import ODOMETRY_SIZE, AgentConfig, Array, OdometryLike
from ptnsbc_sim.user_file import UserFunction, user_function

_EXPECTED = "force [N] and torque [N m], six numbers in the body frame (FLU)"


class ControllerInputs(NamedTuple):
    """The input of a controller at one tick; it must not remember anything."""

    t: float  # [s] since the epoch
    dt: float  # [s] control period
    odometry: Array  # (13,) position [m, ENU], quaternion x y z w, velocity [m/s] and rates [rad/s] of the body
    velocity: Array  # (3,) commanded [m/s, ENU]
    yaw_rate: float  # commanded [rad/s]
    wrench: Array  # (6,) force [N] and torque [N m] of our controller, body FLU
    mass: float  # [kg] that the laws know
    inertia: Array  # (3,) [kg m^2] that the laws know
    gravity: float  # [m/s^2]


_EXAMPLE = ControllerInputs(
    0.0,
    0.01,
    np.zeros(ODOMETRY_SIZE),
    np.zeros(3),
    0.0,
    np.zeros(6),
    1.0,
    np.zeros(3),
    9.81,
)
"""Inputs with the types of all inputs."""


class OwnController:
    """A controller from a file."""

    def __init__(self, function: UserFunction) -> None:
        self._function = function

    def wrench(
        self,
        t: float,
        dt: float,
        odometry: OdometryLike,
        command: Array,
        ours: Array,
        config: AgentConfig,
    ) -> tuple[float, ...]:
        """Force [N] and torque [N m], body FLU.

        Args:
            t: time since the epoch [s].
            dt: control period [s].
            odometry: odometry vector (13,) of the vehicle.
            command: velocity setpoint (4,) [m/s, ENU], [rad/s].
            ours: (6,) what our controller commands.
            config: constants of the UAV.

        Raises:
            UserFileError: the function raised an error, or did not return six finite numbers.
        """
        nominal = config.controller.nominal
        inputs = ControllerInputs(
            float(t),
            float(dt),
            np.array(odometry),
            np.array(command[:3]),
            float(command[3]),
            np.array(ours),
            nominal.mass,
            np.array(nominal.inertia),
            config.controller.gravity,
        )
        call = self._function
        return call.numbers(call(inputs), 6, _EXPECTED, f" at t = {t:.3f} s")


@lru_cache(maxsize=16)
def load_controller(named: str) -> OwnController:
    """Load the controller that FILE.py:NAME names, which executes its file.

    Raises:
        UserFileError: there is no such file or function, or the file raises an error.
    """
    return OwnController(user_function(named, "controller", (_EXAMPLE,)))
