"""The loops of a headless flight: one kernel, with a compiled law in it, or Python between the kernels of a tick."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.algebra import store, store3
from ptnsbc_core.behaviours.formation import place_beside_leader
from ptnsbc_core.kernel import fails, kernel, kernel_list, referred
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.step import TaskPoints, epoch_begins, task_points
from ptnsbc_core.types import MODE_FORMATION, Array
from ptnsbc_sim.disturbances.build import Disturbances
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.plugins.formation_task import load_task
from ptnsbc_sim.plugins.hooks import LawInputs
from ptnsbc_sim.plugins.loader import Plugin, PluginError, load_plugin
from ptnsbc_sim.plugins.uav_plugins import UavPlugins, law_senders
from ptnsbc_sim.plugins.world_plugins import WorldPlugins
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.model import Plugins
from ptnsbc_sim.tick import (
    Loop,
    SwarmState,
    advance_all,
    blown,
    computes,
    inputs_of,
    mode_at,
    sense,
    since_epoch,
    step_all,
)
from ptnsbc_sim.wiring import obstacles_at

_NOWHERE = (0.0, 0.0, 0.0)


@kernel
def _points_of(
    tick: int, row: int, swarm: SwarmState, disturbances: Disturbances | None
) -> TaskPoints:
    """The state at which UAV number `row` evaluates its task; of one that computes nothing, nowhere."""
    if not computes(swarm, tick, row, disturbances):
        return TaskPoints(_NOWHERE, _NOWHERE, _NOWHERE, False)
    inputs, t = inputs_of(swarm, tick, row, disturbances), since_epoch(swarm.wiring, tick, row)
    dt = seconds(swarm.wiring.dt_ns)
    return task_points(swarm.states[row], inputs, t, dt, swarm.configs[row])


class _Guides(NamedTuple):
    """The law of a flight and its UAVs, by rows of the swarm; S: the most senders that one hears."""

    address: int  # of the compiled law; 0: Python calls it
    ids: NDArray[np.int64]  # (N,)
    senders: NDArray[np.int64]  # (N, S) rows, ascending; -1 beyond the last, and of the leader
    received: NDArray[np.int64]  # (T, N, S) tick of the newest state received, or -1
    first: Array  # (M,) memory at an epoch
    given: Array  # (N, 3 + M) newest velocity [m/s, ENU] and memory


def _guides_of(scenario: Scenario, law: Plugin) -> _Guides:
    """The law of a scenario before the first tick."""
    ids = scenario.uav_ids
    heard = [() if uav == scenario.leader.id else law_senders(scenario, uav) for uav in ids]
    shape = len(ids), max(1, *map(len, heard))
    senders = np.full(shape, -1, dtype=np.int64)
    received = np.full((scenario.timing.ticks, *shape), -1, dtype=np.int64)
    for row, others in enumerate(heard):
        for k, other in enumerate(others):
            senders[row, k] = ids.index(other)
            received[:, row, k] = last_state_received(scenario, ids[row], other)
    first, numbers = np.array(law.memory), np.array(ids, dtype=np.int64)
    given = np.zeros((len(ids), 3 + len(first)))
    return _Guides(law.address, numbers, senders, received, first, given)


@kernel
def _known(
    tick: int, row: int, swarm: SwarmState, disturbances: Disturbances | None, guides: _Guides
) -> LawInputs:
    """What UAV number `row` knows, without senders where it does not follow the law; then its velocity is zero."""
    wiring, track, given = swarm.wiring, swarm.track, guides.given[row]
    now_ns, t = tick * wiring.dt_ns, since_epoch(wiring, tick, row)
    senders, count = guides.senders[row], 0
    follows = senders[0] >= 0 and computes(swarm, tick, row, disturbances)
    follows = follows and mode_at(wiring, row, now_ns) == MODE_FORMATION
    if follows and epoch_begins(swarm.states[row], t):
        store(given, 3, guides.first)
    store3(given, 0, (0.0, 0.0, 0.0))
    ids, ages_s = np.zeros(len(senders), dtype=np.int64), np.zeros(len(senders))
    theirs = np.zeros((4, len(senders), 3))  # positions, velocities, places, their velocities
    for k in range(len(senders) if follows else 0):
        sender, sent = senders[k], guides.received[tick, row, k]
        if sent >= 0:
            state = track.reported[sent, sender]
            place = place_beside_leader(swarm.configs[sender], seconds(now_ns))
            ids[count] = guides.ids[sender]
            ages_s[count] = seconds((tick - sent) * wiring.dt_ns)
            store(theirs[0, count], 0, state[:3])
            store3(theirs[1, count], 0, velocity_enu(state))
            store3(theirs[2, count], 0, place.position)
            store3(theirs[3, count], 0, place.velocity)
            count += 1
    own, config = track.odometry[tick, row], swarm.configs[row]
    place = place_beside_leader(config, seconds(now_ns))
    return LawInputs(
        t,
        own[:3].copy(),
        np.array(velocity_enu(own)),
        np.array(place.position),
        np.array(place.velocity),
        ids[:count],
        *(theirs[0, :count], theirs[1, :count], theirs[2, :count], theirs[3, :count]),
        ages_s[:count],
        swarm.near[row, : swarm.near_count[row]],
        config.formation.duration_s,
        config.filter.max_speed,
        given[3:].copy(),
    )


@kernel
def _guide_all(
    tick: int, swarm: SwarmState, disturbances: Disturbances | None, guides: _Guides
) -> int:
    """Have the compiled law give the velocity of every follower; returns the row of one where it failed, or -1."""
    numbers = np.zeros(guides.given.shape[1])
    for row in range(swarm.bodies.shape[0]):
        inputs = _known(tick, row, swarm, disturbances, guides)
        if len(inputs.ids) > 0:
            if fails(guides.address, inputs, numbers) or not np.isfinite(numbers).all():
                return row
            store(guides.given[row], 0, numbers)
    return -1


@kernel
def _fly(
    first: int,
    count: int,
    swarm: SwarmState,
    disturbances: Disturbances | None,
    guides: _Guides | None,
) -> tuple[int, int]:
    """Ticks first .. first + count - 1 of the whole swarm into its track.

    Returns tick and row of a UAV whose law failed, or the end and -1. What depends on `disturbances` and `guides` is
    compiled only for flights that have some: numba drops a branch on None.
    """
    for tick in range(first, first + count):
        sense(swarm, tick, disturbances)
        if guides is None:
            step_all(tick, swarm, None, None, disturbances)
        else:
            failed = _guide_all(tick, swarm, disturbances, guides)
            if failed >= 0:
                return tick, failed
            step_all(tick, swarm, guides.given, None, disturbances)
        advance_all(tick, swarm, disturbances)
    return first + count, -1


def loop_of(scenario: Scenario) -> Loop:
    """The loop of a headless flight; PluginError when a plug-in cannot be loaded, as of a bag."""
    if scenario.law or scenario.plugins != Plugins():
        return PluginLoop(scenario)
    return partial(_fly, guides=None)


class PluginLoop:
    """One headless flight with the plug-ins that its scenario names."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._ids = scenario, scenario.uav_ids
        named = scenario.plugins
        self._task = load_task(named.task) if named.task else None
        self._controller = load_plugin("controller", named.controller) if named.controller else None
        self._world = WorldPlugins(scenario)
        self._law = load_plugin("law", scenario.law) if scenario.law else None
        self._guides = referred(_guides_of(scenario, self._law)) if self._law else None
        self._is_kernel = named == Plugins() and self._law is not None and self._law.address > 0

    def __call__(
        self, first: int, count: int, swarm: SwarmState, disturbances: Disturbances | None
    ) -> None:
        """Ticks first .. first + count - 1 of the whole swarm into its track."""
        if self._is_kernel:
            tick, row = _fly(first, count, swarm, disturbances, self._guides)
            if row >= 0:
                self._guide(tick, row, swarm, disturbances)
                raise PluginError(f"{self._scenario.law}: failed once: expected a pure function")
            return
        for tick in range(first, first + count):
            sense(swarm, tick, disturbances)
            self._sense(tick, swarm, disturbances)
            tasks = None
            if self._task is not None:
                rows = range(len(self._ids))
                points = [_points_of(tick, row, swarm, disturbances) for row in rows]
                tasks = kernel_list([self._task.at(one) for one in points])
            for row in range(len(self._ids) if self._guides else 0):
                self._guide(tick, row, swarm, disturbances)
            velocities = self._guides.given if self._guides else None
            step_all(tick, swarm, velocities, tasks, disturbances)
            if self._controller is not None:
                self._control(tick, swarm, disturbances)
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

    def _guide(
        self, tick: int, row: int, swarm: SwarmState, disturbances: Disturbances | None
    ) -> None:
        """Have the law give the velocity of UAV number `row`; PluginError where it fails."""
        assert self._guides is not None and self._law is not None
        inputs = _known(tick, row, swarm, disturbances, self._guides)
        if len(inputs.ids):
            self._guides.given[row] = self._law.numbers(inputs, at=f"t = {inputs.t:.3f} s")

    def _control(self, tick: int, swarm: SwarmState, disturbances: Disturbances | None) -> None:
        dt, track = seconds(self._scenario.timing.dt_ns), swarm.track
        plugins = UavPlugins(controller=self._controller)
        for row in range(len(self._ids)):
            if disturbances is None or not disturbances.gone[tick, row]:
                t, config = since_epoch(swarm.wiring, tick, row), swarm.configs[row]
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
