"""The loop of a headless flight with functions of the user: Python between the kernels of a tick."""

from __future__ import annotations

from collections.abc import Iterator, MutableSequence, Sequence

import numpy as np

from ptnsbc_core.kernel import borrowed, kernel, kernel_list
from ptnsbc_core.step import guided_step, step, task_points, tasked_step
from ptnsbc_core.tasks.contract import TaskGeometry
from ptnsbc_core.types import Array
from ptnsbc_sim.disturbances.build import Disturbances
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.disturbances.sensor_noise import add_sensor_noise
from ptnsbc_sim.law import Heard, UavLaw
from ptnsbc_sim.own_controller import OwnController, load_controller
from ptnsbc_sim.own_task import NO_TASK, OwnTask, load_task
from ptnsbc_sim.own_world import OwnWorld
from ptnsbc_sim.plants.contract import plant_at, put_plant
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.tick import (
    Loop,
    SwarmState,
    advance_plant,
    blown,
    computes,
    dead,
    inputs_of,
    sense,
    since_epoch,
)
from ptnsbc_sim.track import FlightTrack, note
from ptnsbc_sim.wiring import Wiring, obstacles_at

_POINTS = 9  # own, parent and reference of a task; then whether the parent has been heard


@kernel
def _step_all(
    tick: int,
    wiring: Wiring,
    swarm: SwarmState,
    track: FlightTrack,
    velocities: Array | None,
    tasks: Sequence[TaskGeometry] | None,
    disturbances: Disturbances | None,
) -> None:
    """The control step of every UAV: followers by velocities (N, 3) [m/s, ENU] of a law, or by a task, if given."""
    wiring, swarm, track = borrowed(wiring), borrowed(swarm), borrowed(track)
    dt = wiring.dt_ns * 1e-9
    for row in range(swarm.bodies.shape[0]):
        if not computes(swarm, track, tick, row, disturbances):
            continue
        t = since_epoch(wiring, tick, row)
        inputs = inputs_of(swarm, wiring, track, tick, row, disturbances)
        state, config = swarm.states[row], swarm.configs[row]
        follows = row != wiring.leader[row]
        if tasks is not None and follows:
            swarm.states[row], out = tasked_step(state, inputs, tasks[row], t, dt, config)
        elif velocities is not None and follows:
            wanted = (velocities[row, 0], velocities[row, 1], velocities[row, 2])
            swarm.states[row], out = guided_step(state, inputs, wanted, t, dt, config)
        else:
            swarm.states[row], out = step(state, inputs, t, dt, config)
        note(track, tick, row, out)


@kernel
def _task_points(
    tick: int,
    wiring: Wiring,
    swarm: SwarmState,
    track: FlightTrack,
    disturbances: Disturbances | None,
) -> Array:
    """The states at which the UAVs evaluate their tasks: rows (N, 10)."""
    wiring, swarm, track = borrowed(wiring), borrowed(swarm), borrowed(track)
    dt = wiring.dt_ns * 1e-9
    out = np.zeros((swarm.bodies.shape[0], _POINTS + 1))
    for row in range(swarm.bodies.shape[0]):
        if not computes(swarm, track, tick, row, disturbances):
            continue
        inputs = inputs_of(swarm, wiring, track, tick, row, disturbances)
        t = since_epoch(wiring, tick, row)
        found = task_points(swarm.states[row], inputs, t, dt, swarm.configs[row])
        for i in range(3):
            out[row, i] = found.own[i]
            out[row, 3 + i] = found.parent[i]
            out[row, 6 + i] = found.reference[i]
        out[row, _POINTS] = 1.0 if found.heard else 0.0
    return out


@kernel
def _advance_all(
    tick: int,
    wiring: Wiring,
    swarm: SwarmState,
    track: FlightTrack,
    disturbances: Disturbances | None,
) -> None:
    wiring, swarm, track = borrowed(wiring), borrowed(swarm), borrowed(track)
    for row in range(swarm.bodies.shape[0]):
        advance_plant(swarm, wiring, track, tick, row, disturbances)


@kernel
def _flies(
    tick: int, row: int, wiring: Wiring, swarm: SwarmState, disturbances: Disturbances | None
) -> bool:
    return blown(swarm, wiring, tick, row, disturbances)


class _Laws:
    """The user's law of every follower, and the states that each has received."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._rows = {uav: row for row, uav in enumerate(scenario.uav_ids)}
        self._laws = [(self._rows[uav], UavLaw.of(scenario, uav)) for uav in scenario.followers]
        self._received = {
            (row, sender): last_state_received(scenario, law.uav, sender)
            for row, law in self._laws
            for sender in law.senders
        }
        self._velocities = np.zeros((len(self._rows), 3))

    def _heard(self, track: FlightTrack, tick: int, row: int, law: UavLaw) -> Iterator[Heard]:
        for sender in law.senders:
            sent = int(self._received[row, sender][tick])
            if sent >= 0:
                age_s = ((tick - sent) * self._scenario.dt_ns) * 1e-9
                yield Heard(sender, track.reported[sent, self._rows[sender]], age_s)

    def velocities(self, tick: int, t: float, swarm: SwarmState, track: FlightTrack) -> Array:
        """Velocities (N, 3) [m/s, ENU]; zeros for the leader."""
        for row, law in self._laws:
            near = swarm.near[row, : swarm.near_count[row]]
            found = self._heard(track, tick, row, law)
            self._velocities[row] = law.velocity(t, track.odometry[tick, row], found, near)
        return self._velocities


def _tasks(points: Array, task: OwnTask) -> MutableSequence[TaskGeometry]:
    """The task of the user at rows of `_task_points`."""
    return kernel_list(
        [
            task.geometry((a, b, c), (d, e, f), (g, h, i)) if heard else NO_TASK
            for a, b, c, d, e, f, g, h, i, heard in points.tolist()
        ]
    )


class _OwnFlight:
    """One headless flight with the functions that its scenario names."""

    def __init__(self, scenario: Scenario) -> None:
        named = scenario.plugins
        self._ids, self._dt = scenario.uav_ids, scenario.dt_ns * 1e-9
        self._laws = None if scenario.law is None else _Laws(scenario)
        self._task = None if named.task is None else load_task(named.path_of("task"))
        self._controller: OwnController | None = None
        if named.controller is not None:
            self._controller = load_controller(named.path_of("controller"))
        self._world = OwnWorld.of(scenario)
        self._configs = [agent_config(scenario, uav) for uav in self._ids]

    def fly(
        self,
        first: int,
        count: int,
        wiring: Wiring,
        swarm: SwarmState,
        track: FlightTrack,
        disturbances: Disturbances | None,
    ) -> None:
        """Ticks first .. first + count - 1 of the whole swarm into `track`."""
        for tick in range(first, first + count):
            t = since_epoch(wiring, tick, 0)  # of all: a law and vacancy exclude each other
            sense(swarm, wiring, track, tick, disturbances)
            if self._world is not None and self._world.senses:
                self._sense(tick, wiring, swarm, track, disturbances)
            velocities = (
                None if self._laws is None else self._laws.velocities(tick, t, swarm, track)
            )
            tasks = None
            if self._task is not None:
                tasks = _tasks(_task_points(tick, wiring, swarm, track, disturbances), self._task)
            _step_all(tick, wiring, swarm, track, velocities, tasks, disturbances)
            if self._controller is not None:
                self._control(tick, t, track, disturbances)
            self._advance(tick, wiring, swarm, track, disturbances)

    def _sense(
        self,
        tick: int,
        wiring: Wiring,
        swarm: SwarmState,
        track: FlightTrack,
        disturbances: Disturbances | None,
    ) -> None:
        """Readings of the user's near-object sensor in the place of ours."""
        if self._world is None or tick % wiring.near_every:
            return
        truth = track.odometry[tick] if disturbances is None else track.truth[tick]
        for row in range(len(self._ids)):
            near = self._world.near(row, tick, truth, obstacles_at(wiring, tick), wiring.keep_outs)
            if near is None:
                return
            if disturbances is not None:
                samples = disturbances.sensor_samples[tick // wiring.near_every, row]
                seen, noise = track.odometry[tick, row], disturbances.sensor_noise
                near = add_sensor_noise(near, truth[row], seen, samples, noise)
            swarm.near[row, : len(near)] = near
            swarm.near_count[row] = len(near)

    def _control(
        self, tick: int, t: float, track: FlightTrack, disturbances: Disturbances | None
    ) -> None:
        assert self._controller is not None
        for row, config in enumerate(self._configs):
            if disturbances is None or not dead(tick, row, disturbances):
                track.wrench[tick, row] = self._controller.wrench(
                    t,
                    self._dt,
                    track.odometry[tick, row],
                    track.velocity[tick, row],
                    track.wrench[tick, row],
                    config,
                )

    def _advance(
        self,
        tick: int,
        wiring: Wiring,
        swarm: SwarmState,
        track: FlightTrack,
        disturbances: Disturbances | None,
    ) -> None:
        world = self._world
        if world is not None and world.disturbs:
            truth = track.odometry[tick] if disturbances is None else track.truth[tick]
            for row, uav in enumerate(self._ids):
                plant = plant_at(swarm.plants, row)
                put_plant(swarm.plants, row, world.pushed(uav, tick, truth[row], plant))
        if world is None or not world.flies:
            _advance_all(tick, wiring, swarm, track, disturbances)
            return
        for row in range(len(self._ids)):
            if _flies(tick, row, wiring, swarm, disturbances):
                moved = plant_at(swarm.plants, row)
                world.advance(swarm.bodies[row], track.wrench[tick, row], tick, moved)


def own_loop(scenario: Scenario) -> Loop | None:
    """The loop of a flight with functions of the user; None where the scenario names none.

    Raises:
        UserFileError: a function cannot be loaded, or the scenario comes from a bag.
    """
    named = scenario.plugins
    if scenario.law is None and not (named.of_uav or named.of_world):
        return None
    return _OwnFlight(scenario).fly
