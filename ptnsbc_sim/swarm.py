"""Headless flight: the whole swarm in one process, by the same kernels and the same tick as the processes.

At tick k a UAV holds its own odometry of tick k and its neighbours' messages of tick k-1; see
docs/lockstep.md. Nothing here is a law.
"""

from __future__ import annotations

from collections.abc import Callable, MutableSequence, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import KernelList, inline_kernel, kernel, kernel_list
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import (
    MODE_FORMATION,
    NEVER_RECEIVED_S,
    ODOMETRY_SIZE,
    AgentConfig,
    AgentInputs,
    AgentState,
    Array,
)
from ptnsbc_sim.disturbances.build import Disturbances, chance, sight_draws, sight_of
from ptnsbc_sim.disturbances.gusts import blow
from ptnsbc_sim.disturbances.position_noise import believed, no_error
from ptnsbc_sim.disturbances.sensor_noise import beside
from ptnsbc_sim.plants.build import plant_config, start_states
from ptnsbc_sim.plants.contract import PlantConfig
from ptnsbc_sim.plants.integrate import advance, odometry
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.sensor import near_objects
from ptnsbc_sim.track import DIAGNOSTICS_SIZE, FlightTrack, note
from ptnsbc_sim.wiring import Wiring, wiring_of
from ptnsbc_sim.world import measure_all

CHUNK_TICKS = 500


class SwarmState(NamedTuple):
    """The UAVs of a flight, by row: constants, and what is carried from tick to tick (changed in place)."""

    configs: Sequence[AgentConfig]
    plants: Sequence[PlantConfig]
    states: MutableSequence[AgentState]
    bodies: Array  # (N, 17) plant states
    nears: MutableSequence[Array]  # (M, 7) each, last reading of the near-object sensor


class HeadlessFlight(NamedTuple):
    """A headless flight."""

    scenario: Scenario
    t_ns: NDArray[np.int64]  # (T,)
    track: FlightTrack
    wiring: Wiring

    @property
    def truth(self) -> Array:
        """True odometry vectors (T, N, 13), whatever the UAVs believed."""
        return self.track.truth if len(self.track.truth) else self.track.odometry

    def near(self, tick: int, row: int) -> Array:
        """Rows (M, 7) that UAV number `row` saw at a tick that is a multiple of near_every."""
        truth = self.truth[tick]
        rows = near_objects(
            row,
            truth,
            self.wiring.obstacles,
            self.wiring.uav_keep_out_m,
            self.wiring.range_m,
        )
        if not len(self.track.truth):
            return rows
        draws = sight_draws(self.scenario, self.scenario.uav_ids[row], tick)
        seen = self.track.odometry[tick, row]
        return beside(rows, truth[row], seen, draws, sight_of(self.scenario))


@inline_kernel
def _age(tick: int, sent: int, dt_ns: int) -> float:
    """Seconds since a message of tick `sent`, -1: none was heard."""
    return ((tick - sent) * dt_ns) * 1e-9 if sent >= 0 else NEVER_RECEIVED_S


@inline_kernel
def _heard(track: FlightTrack, sent: int, row: int) -> Array:
    """Odometry vector (13,) that UAV number `row` sent at tick `sent`; zeros when there is none."""
    if sent < 0 or row < 0:
        return np.zeros(ODOMETRY_SIZE)
    return track.odometry[sent, row]


@inline_kernel
def inputs_of(
    wiring: Wiring, track: FlightTrack, near: Array, tick: int, row: int, luck: Disturbances | None
) -> AgentInputs:
    """What UAV number `row` knows at `tick`: what was sent at the tick before, or longer ago if that got lost."""
    parent = wiring.parent[row]
    from_parent, from_leader = tick - 1, tick - 1
    if luck is not None:
        from_parent, from_leader = luck.heard[tick, row, 0], luck.heard[tick, row, 1]
    count = 0
    while count < wiring.neighbours.shape[1] and wiring.neighbours[row, count] >= 0:
        count += 1
    estimates = np.zeros((count, ODOMETRY_SIZE))
    ages = np.empty(count)
    for k in range(count):
        sent = tick - 1
        if luck is not None:
            sent = luck.heard[tick, row, 2 + k]
        ages[k] = _age(tick, sent, wiring.dt_ns)
        if sent >= 0:
            store(estimates[k], 0, track.estimate[sent, wiring.neighbours[row, k]])
    pinned = wiring.pinned[row] > 0
    behind = tick % wiring.near_every
    return AgentInputs(
        track.odometry[tick, row],
        _heard(track, from_parent, parent),
        _age(tick, from_parent, wiring.dt_ns) if parent >= 0 else NEVER_RECEIVED_S,
        _heard(track, from_leader, wiring.leader if pinned else -1),
        _age(tick, from_leader, wiring.dt_ns) if pinned else NEVER_RECEIVED_S,
        estimates,
        ages,
        near,
        (behind * wiring.dt_ns) * 1e-9,
        MODE_FORMATION,
        (tick * wiring.dt_ns) * 1e-9,
    )


@kernel
def sense(
    crew: SwarmState, wiring: Wiring, track: FlightTrack, tick: int, luck: Disturbances | None
) -> None:
    """Measure every UAV's odometry, and the near objects when the sensor's turn has come."""
    size = crew.bodies.shape[0]
    true = track.odometry if luck is None else track.truth
    for row in range(size):
        store(true[tick, row], 0, odometry(crew.bodies[row], crew.plants[row]))
    if luck is not None:
        for row in range(size):
            store(track.odometry[tick, row], 0, _believed(track, tick, row, wiring, luck))
    if tick % wiring.near_every == 0:
        for row in range(size):
            near = near_objects(
                row, true[tick], wiring.obstacles, wiring.uav_keep_out_m, wiring.range_m
            )
            if luck is not None:
                draws = luck.sights[tick // wiring.near_every, row]
                seen = track.odometry[tick, row]
                near = beside(near, true[tick, row], seen, draws, luck.sight)
            crew.nears[row] = near


@kernel
def _believed(track: FlightTrack, tick: int, row: int, wiring: Wiring, luck: Disturbances) -> Array:
    """Odometry vector (13,) that UAV number `row` sees, from its true one."""
    return believed(
        track.truth[tick, row],
        track.truth[max(tick - luck.odometer.delay, 0), row],
        track.truth[max(tick - luck.odometer.known, 0), row],
        luck.errors[row],
        luck.fixes[tick, row],
        tick,
        wiring.dt_ns * 1e-9,
        luck.odometer,
    )


@kernel
def _fly(
    first: int,
    count: int,
    wiring: Wiring,
    crew: SwarmState,
    track: FlightTrack,
    luck: Disturbances | None,
) -> None:
    """Ticks first .. first + count - 1 of the whole swarm into `track`.

    What depends on `luck` is compiled only for flights that have some: numba drops a branch on None.
    """
    dt = wiring.dt_ns * 1e-9
    for tick in range(first, first + count):
        t = (tick * wiring.dt_ns) * 1e-9
        sense(crew, wiring, track, tick, luck)
        for row in range(crew.bodies.shape[0]):
            inputs = inputs_of(wiring, track, crew.nears[row], tick, row, luck)
            crew.states[row], out = step(crew.states[row], inputs, t, dt, crew.configs[row])
            note(track, tick, row, out)
            if luck is not None:
                wind = crew.plants[row].wind
                blow(luck.gust[row], wind, luck.blows[tick, row], tick, luck.gusts)
            wrench, plant = track.wrench[tick, row], crew.plants[row]
            advance(crew.bodies[row], wrench, t, dt, wiring.substeps, plant)


@kernel
def _starts(configs: Sequence[AgentConfig], seen: Array) -> MutableSequence[AgentState]:
    states = KernelList()
    for row in range(len(configs)):
        states.append(initial_state(seen[row], configs[row]))
    return states


def _first_seen(truth: Array, dt: float, luck: Disturbances | None) -> Array:
    """Odometry vectors (N, 13) that the UAVs see at the first tick, from the true ones."""
    if luck is None:
        return truth
    kind = luck.odometer
    rows = [
        believed(own, own, own, no_error(kind), luck.fixes[0, row], 0, dt, kind)
        for row, own in enumerate(truth)
    ]
    return np.stack(rows)


Loop = Callable[[int, int, Wiring, SwarmState, FlightTrack, Disturbances | None], None]
"""Flies so many ticks from the first: the law is in it."""


def fly(scenario: Scenario, progress: Callable[[int, int], None] | None = None) -> HeadlessFlight:
    """Fly a scenario headless.

    Args:
        scenario: what to fly.
        progress: called with (ticks done, ticks in all) now and then.

    Returns:
        The whole flight; the same scenario gives the same bytes.
    """
    return flown(scenario, _fly, progress)


def flown(
    scenario: Scenario, loop: Loop, progress: Callable[[int, int], None] | None = None
) -> HeadlessFlight:
    """As `fly`, with the law in `loop`."""
    ticks, size = scenario.ticks, len(scenario.uav_ids)
    plants = [plant_config(scenario, uav_id) for uav_id in scenario.uav_ids]
    configs = kernel_list([agent_config(scenario, uav_id) for uav_id in scenario.uav_ids])
    bodies = start_states(scenario, plants)
    plant_list = kernel_list(plants)
    wiring = wiring_of(scenario)
    luck = chance(scenario, wiring.neighbours.shape[1])
    seen = _first_seen(measure_all(bodies, plant_list), wiring.dt_ns * 1e-9, luck)
    crew = SwarmState(
        configs,
        plant_list,
        _starts(configs, seen),
        bodies,
        kernel_list([np.empty((0, 7)) for _ in range(size)]),
    )
    widths = (ODOMETRY_SIZE, 4, 6, ODOMETRY_SIZE, DIAGNOSTICS_SIZE, ODOMETRY_SIZE)
    track = FlightTrack(*(np.zeros((ticks, size, width)) for width in widths))
    if luck is None:
        track = track._replace(truth=np.zeros((0, size, ODOMETRY_SIZE)))
    for first in range(0, ticks, CHUNK_TICKS):
        count = min(CHUNK_TICKS, ticks - first)
        loop(first, count, wiring, crew, track, luck)
        if progress is not None:
            progress(first + count, ticks)
    t_ns = np.arange(ticks, dtype=np.int64) * scenario.dt_ns
    return HeadlessFlight(scenario, t_ns, track, wiring)
