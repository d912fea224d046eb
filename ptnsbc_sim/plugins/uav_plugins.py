"""The plug-ins that one UAV flies by: law, task and controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ptnsbc_core.behaviours.formation import place_beside_leader
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import AgentConfig, Array, OdometryLike, Vector3
from ptnsbc_sim.plugins.formation_task import PluginTask, load_task
from ptnsbc_sim.plugins.hooks import ControllerInputs, LawInputs
from ptnsbc_sim.plugins.loader import Plugin, load_plugin
from ptnsbc_sim.scenario import Scenario, agent_config

_REST: Vector3 = (0.0, 0.0, 0.0)


class Heard(NamedTuple):
    """The newest state of one sender."""

    sender: int
    state: Array  # (13,) odometry vector
    age_s: float


def law_senders(scenario: Scenario, uav: int) -> tuple[int, ...]:
    """The UAVs that the law of a follower hears, ascending."""
    heard = {scenario.communication.parent(uav), *scenario.topology.neighbours.get(uav, ())}
    heard |= {scenario.leader.id} if uav in scenario.topology.pinned else set()
    return tuple(sorted(sender for sender in heard if sender is not None))


class UavLaw:
    """A law as one follower flies it in a process; `loop` has the same for a headless flight."""

    def __init__(self, law: Plugin, scenario: Scenario, uav: int) -> None:
        self.law, self._own = law, agent_config(scenario, uav)
        self._configs = {one: agent_config(scenario, one) for one in law_senders(scenario, uav)}
        place_beside_leader(self._own, 0.0)  # it is compiled before the flight

    def velocity(
        self,
        t: float,
        start_t: float,
        own: Array,
        heard: Iterable[Heard],
        near: Array,
        memory: Array,
    ) -> tuple[Vector3, Array]:
        """The velocity [m/s, ENU], zero while nothing has been heard, and the memory (M,) for the next step.

        `t` and `start_t` [s] count from the latest epoch and from the first; `own` is the odometry vector (13,);
        `heard` has the newest states of the `senders` of whom something came, ascending; `near` (M, 7) is as in
        LawInputs.
        """
        messages = list(heard)
        if not messages:
            return _REST, memory
        places = [place_beside_leader(self._configs[one.sender], start_t) for one in messages]
        place = place_beside_leader(self._own, start_t)
        inputs = LawInputs(
            t,
            own[:3].copy(),
            np.array(velocity_enu(own)),
            np.array(place.position),
            np.array(place.velocity),
            np.array([message.sender for message in messages], dtype=np.int64),
            np.array([message.state[:3] for message in messages]),
            np.array([velocity_enu(message.state) for message in messages]),
            np.array([other.position for other in places]),
            np.array([other.velocity for other in places]),
            np.array([message.age_s for message in messages]),
            np.ascontiguousarray(near),
            self._own.formation.duration_s,
            self._own.filter.max_speed,
            memory.copy(),
        )
        x, y, z, *kept = self.law.numbers(inputs, at=f"t = {t:.3f} s")
        return (x, y, z), np.array(kept)


class UavPlugins(NamedTuple):
    """The plug-ins of one UAV; None: ours.

    PluginError when one cannot be loaded, as of a bag, and when a function fails or gives no such numbers.
    """

    law: UavLaw | None = None
    task: PluginTask | None = None
    controller: Plugin | None = None
    memory: tuple[float, ...] = ()  # of the law at an epoch, also where this UAV does not follow it

    @classmethod
    def of(cls, scenario: Scenario, uav: int) -> UavPlugins:
        """The plug-ins that a scenario names for a UAV: the leader has neither law nor task."""
        named, follows = scenario.plugins, uav != scenario.leader.id
        law = None if scenario.law is None else load_plugin("law", scenario.law)
        return cls(
            UavLaw(law, scenario, uav) if law is not None and follows else None,
            load_task(named.task) if named.task is not None and follows else None,
            None if named.controller is None else load_plugin("controller", named.controller),
            () if law is None else law.memory,
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
