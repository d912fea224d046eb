"""The loop of a headless flight with plug-ins: Python between the kernels of a tick."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ptnsbc_core.algebra import store3
from ptnsbc_core.kernel import kernel, kernel_list
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.step import TaskPoints, task_points
from ptnsbc_core.tasks.formation_tasks import TaskGeometry
from ptnsbc_core.types import Array
from ptnsbc_sim.disturbances.build import Disturbances
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.plugins.formation_task import PluginTask
from ptnsbc_sim.plugins.uav_plugins import Heard, UavLaw, UavPlugins
from ptnsbc_sim.plugins.world_plugins import WorldPlugins
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.model import Plugins
from ptnsbc_sim.tick import (
    SwarmState,
    advance_all,
    blown,
    computes,
    inputs_of,
    sense,
    since_epoch,
    step_all,
)
from ptnsbc_sim.track import FlightTrack
from ptnsbc_sim.wiring import obstacles_at

_HEARD = 9  # column of a row of points: whether the parent has been heard; own, parent and reference stand before it


@kernel
def _task_points(tick: int, swarm: SwarmState, disturbances: Disturbances | None) -> Array:
    """The states at which the UAVs evaluate their tasks: rows (N, 10)."""
    dt = seconds(swarm.wiring.dt_ns)
    out = np.zeros((swarm.bodies.shape[0], _HEARD + 1))
    for row in range(swarm.bodies.shape[0]):
        if computes(swarm, tick, row, disturbances):
            inputs = inputs_of(swarm, tick, row, disturbances)
            t = since_epoch(swarm.wiring, tick, row)
            points = task_points(swarm.states[row], inputs, t, dt, swarm.configs[row])
            store3(out[row], 0, points.own)
            store3(out[row], 3, points.parent)
            store3(out[row], 6, points.reference)
            out[row, _HEARD] = 1.0 if points.heard else 0.0
    return out


class PluginLoop:
    """One headless flight with the plug-ins that its scenario names."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._ids = scenario, scenario.uav_ids
        self._rows = {uav: row for row, uav in enumerate(self._ids)}
        self._uavs = [UavPlugins.of(scenario, uav) for uav in self._ids]
        self._task = next((plugins.task for plugins in self._uavs if plugins.task), None)
        self._controls = any(plugins.controller for plugins in self._uavs)
        self._world = WorldPlugins(scenario)
        self._configs = [agent_config(scenario, uav) for uav in self._ids]
        self._received = {
            (row, sender): last_state_received(scenario, plugins.law.uav, sender)
            for row, plugins in enumerate(self._uavs)
            if plugins.law is not None
            for sender in plugins.law.senders
        }

    @classmethod
    def of(cls, scenario: Scenario) -> PluginLoop | None:
        """The loop of a flight with plug-ins; None where the scenario names none.

        Raises:
            PluginError: one cannot be loaded, or the scenario comes from a bag.
        """
        return cls(scenario) if scenario.law or scenario.plugins != Plugins() else None

    def __call__(
        self, first: int, count: int, swarm: SwarmState, disturbances: Disturbances | None
    ) -> None:
        """Ticks first .. first + count - 1 of the whole swarm into its track."""
        for tick in range(first, first + count):
            t = since_epoch(swarm.wiring, tick, 0)  # of all: a law and vacancy exclude each other
            sense(swarm, tick, disturbances)
            self._sense(tick, swarm, disturbances)
            tasks = None
            if self._task is not None:
                points = _task_points(tick, swarm, disturbances).tolist()
                tasks = kernel_list([_geometry(self._task, row) for row in points])
            step_all(tick, swarm, self._velocities(tick, t, swarm), tasks, disturbances)
            if self._controls:
                self._control(tick, t, swarm.track, disturbances)
            self._advance(tick, swarm, disturbances)

    def _sense(self, tick: int, swarm: SwarmState, disturbances: Disturbances | None) -> None:
        """Readings of the near-object sensor that is plugged in, in the place of ours."""
        wiring, track = swarm.wiring, swarm.track
        if self._world.sensor is None or tick % wiring.near_every:
            return
        truth = track.odometry[tick] if disturbances is None else track.truth[tick]
        obstacles = obstacles_at(wiring, tick)
        for row in range(len(self._ids)):
            seen = None if disturbances is None else track.odometry[tick, row]
            near = self._world.near(row, tick, truth, seen, obstacles, wiring.keep_outs)
            swarm.near[row, : len(near)] = near
            swarm.near_count[row] = len(near)

    def _velocities(self, tick: int, t: float, swarm: SwarmState) -> Array | None:
        """Velocities (N, 3) [m/s, ENU] of the law, zeros for the leader; None without a law."""
        if not self._received:
            return None
        track, velocities = swarm.track, np.zeros((len(self._ids), 3))
        for row, plugins in enumerate(self._uavs):
            if plugins.law is not None:
                near = swarm.near[row, : swarm.near_count[row]]
                heard = self._heard(track, tick, row, plugins.law)
                velocities[row] = plugins.law.velocity(t, track.odometry[tick, row], heard, near)
        return velocities

    def _heard(self, track: FlightTrack, tick: int, row: int, law: UavLaw) -> Iterator[Heard]:
        for sender in law.senders:
            sent = int(self._received[row, sender][tick])
            if sent >= 0:
                age_s = seconds((tick - sent) * self._scenario.timing.dt_ns)
                yield Heard(sender, track.reported[sent, self._rows[sender]], age_s)

    def _control(
        self, tick: int, t: float, track: FlightTrack, disturbances: Disturbances | None
    ) -> None:
        dt = seconds(self._scenario.timing.dt_ns)
        for row, (plugins, config) in enumerate(zip(self._uavs, self._configs, strict=True)):
            if disturbances is None or not disturbances.gone[tick, row]:
                odometry, command = track.odometry[tick, row], track.velocity[tick, row]
                ours = track.wrench[tick, row]
                track.wrench[tick, row] = plugins.wrench(t, dt, odometry, command, ours, config)

    def _advance(self, tick: int, swarm: SwarmState, disturbances: Disturbances | None) -> None:
        world, track = self._world, swarm.track
        if world.disturbance is not None:
            truth = track.odometry[tick] if disturbances is None else track.truth[tick]
            for row, uav in enumerate(self._ids):
                swarm.plants[row] = world.disturbed(uav, tick, truth[row], swarm.plants[row])
        if world.plant is None:
            advance_all(tick, swarm, disturbances)
            return
        for row in range(len(self._ids)):
            if blown(swarm, tick, row, disturbances):
                wrench, plant = track.wrench[tick, row], swarm.plants[row]
                world.advance(swarm.bodies[row], wrench, tick, plant)


def _geometry(task: PluginTask, row: Sequence[float]) -> TaskGeometry:
    """The task at a row of `_task_points`."""
    a, b, c, d, e, f, g, h, i, heard = row
    return task.at(TaskPoints((a, b, c), (d, e, f), (g, h, i), heard > 0.0))
