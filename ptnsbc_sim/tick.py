"""One tick of a headless flight: what a UAV senses and hears, and what its plant makes of its command.

At tick k a UAV holds its own odometry of tick k and its neighbours' messages of tick k-1; see
docs/lockstep.md. Nothing here is a law.
"""

from __future__ import annotations

from collections.abc import Callable, MutableSequence, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.algebra import odometry_tuple, store
from ptnsbc_core.behaviours.neighbour import mean_parent
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.step import initial_state, step
from ptnsbc_core.tasks.formation_tasks import TaskGeometry
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_HOLD,
    MODE_LAND,
    NEVER_RECEIVED_S,
    ODOMETRY_SIZE,
    AgentConfig,
    AgentInputs,
    AgentState,
    Array,
)
from ptnsbc_sim.disturbances.build import Disturbances
from ptnsbc_sim.disturbances.faults import add_jumps
from ptnsbc_sim.disturbances.noise import add_sensor_noise, gust_step, measured_odometry
from ptnsbc_sim.plants.contract import PlantConfig, Waves
from ptnsbc_sim.plants.integrate import advance_with, stop, store_odometry
from ptnsbc_sim.sensor import store_near
from ptnsbc_sim.track import FlightTrack, note, note_silence
from ptnsbc_sim.wiring import Wiring, obstacles_at


class SwarmState(NamedTuple):
    """The UAVs of a flight, by row: constants, what is carried from tick to tick, its record, and room to work in.

    Everything but the constants is changed in place.
    """

    wiring: Wiring
    track: FlightTrack
    configs: MutableSequence[AgentConfig]
    plants: MutableSequence[PlantConfig]
    states: MutableSequence[AgentState]
    bodies: Array  # (N, 17) plant states
    near: Array  # (N, N - 1 + O, 8) last reading of the near-object sensor
    near_count: NDArray[np.int64]  # (N,) rows of it that are used
    estimates: Array  # (N, K, 13) received leader estimates
    estimate_age_s: Array  # (N, K)
    parent_states: Array  # (P, 13) received from the parents of the UAV that is about to step
    parent_age_s: Array  # (P,)
    parent_mean: Array  # (13,) the message of a parent that stands for several
    nothing: Array  # (13,) zeros: the message of a sender that is not there
    waves: Waves


Loop = Callable[[int, int, SwarmState, Disturbances | None], object]
"""Flies so many ticks from the first: the law is in it."""


@inline_kernel
def _age(tick: int, sent: int, dt_ns: int) -> float:
    """Seconds since a message of tick `sent`, -1: none was received."""
    return seconds((tick - sent) * dt_ns) if sent >= 0 else NEVER_RECEIVED_S


@inline_kernel
def _received(swarm: SwarmState, sent: int, row: int) -> Array:
    """Odometry vector (13,) that UAV number `row` sent at tick `sent`; zeros when there is none."""
    if sent < 0 or row < 0:
        return swarm.nothing
    return swarm.track.reported[sent, row]


@kernel
def _mean_parent(
    swarm: SwarmState, tick: int, row: int, disturbances: Disturbances | None
) -> float:
    """Set `parent_mean` of a UAV with several parents; returns its age [s]."""
    wiring = swarm.wiring
    parents, neighbours = wiring.parents, wiring.neighbours.shape[1]
    count = parents.several[row]
    states, ages = swarm.parent_states[:count], swarm.parent_age_s[:count]
    for k in range(count):
        sent = tick - 1
        if disturbances is not None:
            sent = disturbances.received[tick, row, 2 + neighbours + k]
        ages[k] = _age(tick, sent, wiring.dt_ns)
        store(states[k], 0, _received(swarm, sent, parents.rows[row, k]))
    weights, shifts = parents.weights[row, :count], parents.shifts[row, :count]
    return mean_parent(states, ages, weights, shifts, parents.stale_s, swarm.parent_mean)


@inline_kernel
def mode_at(wiring: Wiring, row: int, now_ns: int) -> int:
    """The mode of a UAV: it holds until it joins, and lands at the end of a mission that lands."""
    if now_ns >= wiring.landing_ns[row]:
        return MODE_LAND
    if now_ns < wiring.joins_ns[row]:
        return MODE_HOLD
    return MODE_FORMATION


@inline_kernel
def inputs_of(
    swarm: SwarmState, tick: int, row: int, disturbances: Disturbances | None
) -> AgentInputs:
    """The inputs of UAV number `row` at `tick`: the messages of the tick before, or older ones if those got lost."""
    wiring, track = swarm.wiring, swarm.track
    parent = wiring.parent[row]
    from_parent, from_leader = tick - 1, tick - 1
    if disturbances is not None:
        received = disturbances.received[tick, row]
        from_parent, from_leader = received[0], received[1]
    parent_state = _received(swarm, from_parent, parent)
    parent_age_s = _age(tick, from_parent, wiring.dt_ns) if parent >= 0 else NEVER_RECEIVED_S
    if wiring.parents.several[row] > 0:
        parent_age_s = _mean_parent(swarm, tick, row, disturbances)
        parent_state = swarm.parent_mean
    count = wiring.neighbour_count[row]
    estimates, ages = swarm.estimates[row, :count], swarm.estimate_age_s[row, :count]
    for k in range(count):
        sent = tick - 1
        if disturbances is not None:
            sent = disturbances.received[tick, row, 2 + k]
        ages[k] = _age(tick, sent, wiring.dt_ns)
        sender = wiring.neighbours[row, k]
        for i in range(ODOMETRY_SIZE):
            estimates[k, i] = track.estimate[sent, sender, i] if sent >= 0 else 0.0
    pinned = wiring.pinned[row] > 0
    behind = tick % wiring.near_every
    now_ns = tick * wiring.dt_ns
    return AgentInputs(
        odometry_tuple(track.odometry[tick, row]),
        odometry_tuple(parent_state),
        parent_age_s,
        odometry_tuple(_received(swarm, from_leader, wiring.leader[row] if pinned else -1)),
        _age(tick, from_leader, wiring.dt_ns) if pinned else NEVER_RECEIVED_S,
        estimates,
        ages,
        swarm.near[row, : swarm.near_count[row]],
        seconds(behind * wiring.dt_ns),
        mode_at(wiring, row, now_ns),
        seconds(now_ns),
    )


@inline_kernel
def since_epoch(wiring: Wiring, tick: int, row: int) -> float:
    """Seconds since the latest epoch of UAV number `row`: the first one, or the begin of its landing."""
    now_ns = tick * wiring.dt_ns
    if now_ns >= wiring.landing_ns[row]:
        now_ns -= wiring.landing_ns[row]
    return seconds(now_ns)


@kernel
def sense(swarm: SwarmState, tick: int, disturbances: Disturbances | None) -> None:
    """Measure every UAV's odometry, and the near objects when the sensor's turn has come."""
    wiring, track, size = swarm.wiring, swarm.track, swarm.bodies.shape[0]
    true = track.odometry if disturbances is None else track.truth
    for row in range(size):
        store_odometry(true[tick, row], swarm.bodies[row], wiring.plant)
    if disturbances is not None:
        for row in range(size):
            store(track.odometry[tick, row], 0, _believed(swarm, tick, row, disturbances))
    if tick % wiring.near_every > 0:
        return
    obstacles = obstacles_at(wiring, tick)
    for row in range(size):
        near, keep_outs = swarm.near[row], wiring.keep_outs
        count = store_near(row, true[tick], obstacles, keep_outs, wiring.range_m, near)
        swarm.near_count[row] = count
        if disturbances is not None:
            samples = disturbances.sensor_samples[tick // wiring.near_every, row]
            seen, kind = track.odometry[tick, row], disturbances.sensor_noise
            measured = add_sensor_noise(near[:count], true[tick, row], seen, samples, kind)
            for k in range(count):
                store(near[k], 0, measured[k])


@kernel
def _believed(swarm: SwarmState, tick: int, row: int, disturbances: Disturbances) -> Array:
    """Odometry vector (13,) that UAV number `row` sees, from its true one."""
    truth, kind = swarm.track.truth, disturbances.position_noise
    measured = measured_odometry(
        truth[tick, row],
        truth[max(tick - kind.delay, 0), row],
        truth[max(tick - kind.compensated, 0), row],
        disturbances.position_errors[row],
        disturbances.position_samples[tick, row],
        tick,
        seconds(swarm.wiring.dt_ns),
        kind,
    )
    add_jumps(measured, tick, row, disturbances.jumps)
    return measured


@inline_kernel
def computes(swarm: SwarmState, tick: int, row: int, disturbances: Disturbances | None) -> bool:
    """True if UAV number `row` computes at `tick`. One that begins anew starts from what it sees."""
    if disturbances is not None:
        if disturbances.gone[tick, row]:
            note_silence(swarm.track, tick, row)
            return False
        if tick > 0 and disturbances.gone[tick - 1, row]:
            swarm.states[row] = initial_state(swarm.track.odometry[tick, row], swarm.configs[row])
    return True


@inline_kernel
def blown(swarm: SwarmState, tick: int, row: int, disturbances: Disturbances | None) -> bool:
    """Set the gust around UAV number `row`; whether it flies. One whose process was killed stops where it is."""
    if disturbances is not None:
        samples, wind = disturbances.gust_samples[tick, row], swarm.plants[row].wind
        gust_step(disturbances.gust[row], wind, samples, tick, disturbances.gusts)
        if disturbances.gone[tick, row]:
            stop(swarm.bodies[row], swarm.wiring.plant)
            return False
    return True


@inline_kernel
def advance_plant(
    swarm: SwarmState, tick: int, row: int, disturbances: Disturbances | None
) -> None:
    """One control period of UAV number `row` under the wrench that it has just commanded."""
    if blown(swarm, tick, row, disturbances):
        dt_ns, wrench = swarm.wiring.dt_ns, swarm.track.wrench[tick, row]
        t, dt = seconds(tick * dt_ns), seconds(dt_ns)
        advance_with(swarm.bodies[row], wrench, t, dt, swarm.plants[row], swarm.waves)


@kernel
def step_all(
    tick: int,
    swarm: SwarmState,
    velocities: Array | None,
    tasks: Sequence[TaskGeometry] | None,
    disturbances: Disturbances | None,
) -> None:
    """The control step of every UAV that computes; `velocities` (N, 3) [m/s, ENU] and `tasks` are of followers."""
    wiring, dt = swarm.wiring, seconds(swarm.wiring.dt_ns)
    for row in range(swarm.bodies.shape[0]):
        if not computes(swarm, tick, row, disturbances):
            continue
        t = since_epoch(wiring, tick, row)
        inputs = inputs_of(swarm, tick, row, disturbances)
        state, config = swarm.states[row], swarm.configs[row]
        follows = row != wiring.leader[row]
        if tasks is not None and follows:
            at = tasks[row]  # by pointer; a step takes it by value, as the tasks of ours
            task = TaskGeometry(at.value, at.own, at.parent, at.reference, at.periodic)
            swarm.states[row], out = step(state, inputs, t, dt, config, None, task)
        elif velocities is not None and follows:
            wanted = (velocities[row, 0], velocities[row, 1], velocities[row, 2])
            swarm.states[row], out = step(state, inputs, t, dt, config, wanted)
        else:
            swarm.states[row], out = step(state, inputs, t, dt, config)
        note(swarm.track, tick, row, out)


@kernel
def advance_all(tick: int, swarm: SwarmState, disturbances: Disturbances | None) -> None:
    """All plants by one control period; apart from the steps, because the code of both does not fit the cache."""
    for row in range(swarm.bodies.shape[0]):
        advance_plant(swarm, tick, row, disturbances)
