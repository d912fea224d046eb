"""Laws of the user: one function in a Python file, which gives a follower its velocity from what it knows.

The function is compiled where numba can compile it; where not, it is interpreted, which is said in one line. Every
error names the file of the user and the line in it. Only files that a scenario file or the user names are executed,
never what a bag names.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import Array, Vector3
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.user_file import UserFileError, UserFunction, user_function

_REST: Vector3 = (0.0, 0.0, 0.0)


class LawError(UserFileError):
    """A law that cannot be loaded, or that does not give a velocity."""


class LawInputs(NamedTuple):
    """The input of a law at one tick; positions and velocities are ENU. K: senders heard, M: objects near."""

    t: float  # [s] since the epoch
    position: Array  # (3,) own [m]
    velocity: Array  # (3,) own [m/s]
    offset: Array  # (3,) own place relative to the leader [m]
    ids: NDArray[np.int64]  # (K,) parent, leader where it is heard, neighbours; ascending
    positions: Array  # (K, 3) of the senders [m]
    velocities: Array  # (K, 3) that they command [m/s]
    offsets: Array  # (K, 3) their places relative to the leader [m]
    ages_s: Array  # (K,) ages of what they sent
    near: Array  # (M, 7) objects near: x y z [m], keep-out radius [m], vx vy vz [m/s]
    deadline_s: float  # of the formation, counted from the epoch
    max_speed_m_s: float  # to which the command is limited


class Heard(NamedTuple):
    """The newest state of one sender."""

    sender: int
    state: Array  # (13,) odometry vector
    age_s: float


class LoadedLaw(UserFunction):
    """A law from a file."""

    def __call__(self, inputs: LawInputs) -> Vector3:
        """The velocity [m/s, ENU].

        Raises:
            LawError: the law raised an error, or did not return three finite numbers.
        """
        at = f" at t = {inputs.t:.3f} s"
        try:
            x, y, z = self.numbers(super().__call__(inputs), 3, _VELOCITY, at)
        except UserFileError as error:
            raise LawError(str(error)) from error
        return x, y, z


_VELOCITY = "a velocity of three numbers [m/s, ENU]"


@lru_cache(maxsize=16)
def load_law(named: str) -> LoadedLaw:
    """Load a law, which executes its file.

    Args:
        named: FILE.py:NAME; the file by its whole path, or relative to the current folder.

    Raises:
        LawError: there is no such file or function, or the file raises an error.
    """
    try:
        found = user_function(named, "law", (_EXAMPLE,))
    except UserFileError as error:
        raise LawError(str(error)) from error
    return LoadedLaw(found.file, found.name, found.function, found.call)


_EXAMPLE = LawInputs(
    0.0,
    np.zeros(3),
    np.zeros(3),
    np.zeros(3),
    np.zeros(1, dtype=np.int64),
    np.zeros((1, 3)),
    np.zeros((1, 3)),
    np.zeros((1, 3)),
    np.zeros(1),
    np.zeros((1, 7)),
    1.0,
    1.0,
)
"""Inputs with the types of all inputs."""


class UavLaw:
    """A law as one follower flies it."""

    def __init__(self, law: LoadedLaw, scenario: Scenario, uav: int) -> None:
        self.uav = uav
        heard = {scenario.parent(uav), *scenario.estimator_neighbours(uav)}
        heard |= {scenario.leader_id} if scenario.pinned(uav) else set()
        self.senders = tuple(sorted(one for one in heard if one is not None))
        self._law = law
        self._offset = scenario.offset(uav)
        self._offsets = {one: scenario.offset(one) for one in self.senders}
        self._deadline_s = float(scenario.gains.formation.deadline_s)
        self._max_speed = float(scenario.max_speed_m_s(uav))

    @classmethod
    def of(cls, scenario: Scenario, uav: int) -> UavLaw:
        """The law that a scenario names.

        Raises:
            LawError: it cannot be loaded, or the scenario comes from a bag.
        """
        if scenario.law is None or not Path(scenario.law).is_absolute():
            raise LawError(
                f"{scenario.source}: law: {scenario.law}: a bag names a law and does not carry it: expected "
                "a scenario whose law you give"
            )
        return cls(load_law(scenario.law), scenario, uav)

    def velocity(self, t: float, own: Array, heard: Iterable[Heard], near: Array) -> Vector3:
        """The velocity [m/s, ENU] at one tick; zero while nothing has been heard.

        Args:
            t: time since the epoch [s].
            own: odometry vector (13,).
            heard: the newest states of `senders`, ascending; without those of whom nothing came.
            near: (M, 7), as in LawInputs.
        """
        found = list(heard)
        if not found:
            return _REST
        states = [one.state for one in found]
        return self._law(
            LawInputs(
                t,
                own[:3].copy(),
                np.array(velocity_enu(own)),
                self._offset,
                np.array([one.sender for one in found], dtype=np.int64),
                np.array([state[:3] for state in states]),
                np.array([velocity_enu(state) for state in states]),
                np.array([self._offsets[one.sender] for one in found]),
                np.array([one.age_s for one in found]),
                np.ascontiguousarray(near),
                self._deadline_s,
                self._max_speed,
            )
        )
