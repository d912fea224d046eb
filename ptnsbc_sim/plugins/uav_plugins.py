"""The plug-ins that one UAV flies by: law, task and controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, cast

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import AgentConfig, Array, OdometryLike, Vector3
from ptnsbc_sim.plugins.formation_task import PluginTask, load_task
from ptnsbc_sim.plugins.hooks import ControllerInputs, LawInputs
from ptnsbc_sim.plugins.loader import Plugin, load_plugin
from ptnsbc_sim.scenario import Scenario

_REST: Vector3 = (0.0, 0.0, 0.0)


class Heard(NamedTuple):
    """The newest state of one sender."""

    sender: int
    state: Array  # (13,) odometry vector
    age_s: float


class UavLaw:
    """A law as one follower flies it."""

    def __init__(self, law: Plugin, scenario: Scenario, uav: int) -> None:
        self.uav = uav
        heard = {scenario.communication.parent(uav), *scenario.topology.neighbours.get(uav, ())}
        heard |= {scenario.leader.id} if uav in scenario.topology.pinned else set()
        self.senders = tuple(sorted(sender for sender in heard if sender is not None))
        self._law = law
        self._offset = scenario.offset(uav)
        self._offsets = {sender: scenario.offset(sender) for sender in self.senders}
        self._deadline_s = float(scenario.gains.formation.deadline_s)
        self._max_speed = float(scenario.max_speed_m_s(uav))

    def velocity(self, t: float, own: Array, heard: Iterable[Heard], near: Array) -> Vector3:
        """The velocity [m/s, ENU] `t` [s] after the epoch; zero while nothing has been heard.

        `own` is the odometry vector (13,); `heard` has the newest states of the `senders` of whom something came,
        ascending; `near` (M, 7) is as in LawInputs.
        """
        messages = list(heard)
        if not messages:
            return _REST
        states = [message.state for message in messages]
        inputs = LawInputs(
            t,
            own[:3].copy(),
            np.array(velocity_enu(own)),
            self._offset,
            np.array([message.sender for message in messages], dtype=np.int64),
            np.array([state[:3] for state in states]),
            np.array([velocity_enu(state) for state in states]),
            np.array([self._offsets[message.sender] for message in messages]),
            np.array([message.age_s for message in messages]),
            np.ascontiguousarray(near),
            self._deadline_s,
            self._max_speed,
        )
        return cast(Vector3, self._law.numbers(inputs, at=f"t = {t:.3f} s"))


class UavPlugins(NamedTuple):
    """The plug-ins of one UAV; None: ours.

    PluginError when one cannot be loaded, as of a bag, and when a function fails or gives no such numbers.
    """

    law: UavLaw | None = None
    task: PluginTask | None = None
    controller: Plugin | None = None

    @classmethod
    def of(cls, scenario: Scenario, uav: int) -> UavPlugins:
        """The plug-ins that a scenario names for a UAV: the leader has neither law nor task."""
        named, follows = scenario.plugins, uav != scenario.leader.id
        law, task = (scenario.law, named.task) if follows else (None, None)
        return cls(
            None if law is None else UavLaw(load_plugin("law", law), scenario, uav),
            None if task is None else load_task(task),
            None if named.controller is None else load_plugin("controller", named.controller),
        )

    def wrench(
        self,
        t: float,
        dt: float,
        odometry: OdometryLike,
        command: Array,
        ours: Array,
        config: AgentConfig,
    ) -> Array | tuple[float, ...]:
        """Force [N] and torque [N m], body FLU: by the controller, or `ours` (6,) without one.

        `t` [s] counts from the epoch, `dt` [s] is the control period, `command` (4,) the setpoint [m/s, ENU], [rad/s].
        """
        if self.controller is None:
            return ours
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
        return self.controller.numbers(inputs, at=f"t = {t:.3f} s")


OURS = UavPlugins()
"""A UAV without plug-ins."""
