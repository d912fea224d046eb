"""Headless flight: the whole swarm in one process, by the same kernels and the same tick as the processes.

At tick k a UAV holds its own odometry of tick k and its neighbours' messages of tick k-1; see
docs/lockstep.md. Nothing here is a law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableSequence, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import KernelList, borrowed, inline_kernel, kernel, kernel_list
from ptnsbc_core.step import guided_step, initial_state, inlined_step, step
from ptnsbc_core.types import (
    MODE_FORMATION,
    MODE_LAND,
    NEAR_COLUMNS,
    NEVER_RECEIVED_S,
    ODOMETRY_SIZE,
    AgentConfig,
    AgentInputs,
    AgentState,
    Array,
)
from ptnsbc_sim.disturbances.build import (
    Disturbances,
    flight_disturbances,
    sensor_noise_of,
    sensor_noise_samples,
)
from ptnsbc_sim.disturbances.faults import add_jumps
from ptnsbc_sim.disturbances.gusts import gust_step
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.disturbances.position_noise import initial_error, measured_odometry
from ptnsbc_sim.disturbances.sensor_noise import add_sensor_noise
from ptnsbc_sim.law import Heard, UavLaw
from ptnsbc_sim.plants.build import plant_config, start_states
from ptnsbc_sim.plants.contract import PlantConfig, Waves, no_waves
from ptnsbc_sim.plants.integrate import advance_with, stop, store_odometry
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.slots import are_open, optimal_slots, with_slots
from ptnsbc_sim.sensor import near_objects, store_near, store_objects
from ptnsbc_sim.track import FlightTrack, note, note_silence, track_of
from ptnsbc_sim.wiring import Wiring, obstacles_at, wiring_of
from ptnsbc_sim.world import World, measure_all

CHUNK_TICKS = 2000


class SwarmState(NamedTuple):
    """The UAVs of a flight, by row: constants, what is carried from tick to tick, and room to work in.

    Everything but the constants is changed in place.
    """

    configs: Sequence[AgentConfig]
    plants: Sequence[PlantConfig]
    states: MutableSequence[AgentState]
    bodies: Array  # (N, 17) plant states
    objects: Array  # (N + O, 7) what the sensors tell of all UAVs and obstacles
    near: Array  # (N, N - 1 + O, 7) last reading of the near-object sensor
    near_count: NDArray[np.int64]  # (N,) rows of it that are used
    estimates: Array  # (N, K, 13) received leader estimates
    estimate_age_s: Array  # (N, K)
    nothing: Array  # (13,) zeros: the message of a sender that is not there
    waves: Waves


Loop = Callable[[int, int, Wiring, SwarmState, FlightTrack, Disturbances | None], None]
"""Flies so many ticks from the first: the law is in it."""


class HeadlessFlight(NamedTuple):
    """A headless flight."""

    scenario: Scenario
    t_ns: NDArray[np.int64]  # (T,)
    track: FlightTrack
    wiring: Wiring
    slots: Mapping[
        int, int
    ]  # slot of every UAV, decided at the epoch; empty where each has its own
    swarm: SwarmState  # as it is at the end

    @property
    def flown(self) -> Scenario:
        """The scenario with the slots that the UAVs took."""
        return with_slots(self.scenario, self.slots) if self.slots else self.scenario

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
            obstacles_at(self.wiring, tick),
            self.wiring.keep_outs,
            self.wiring.range_m,
        )
        if not len(self.track.truth):
            return rows
        samples = sensor_noise_samples(self.scenario, self.scenario.uav_ids[row], tick)
        seen = self.track.odometry[tick, row]
        return add_sensor_noise(rows, truth[row], seen, samples, sensor_noise_of(self.scenario))


@inline_kernel
def _age(tick: int, sent: int, dt_ns: int) -> float:
    """Seconds since a message of tick `sent`, -1: none was received."""
    return ((tick - sent) * dt_ns) * 1e-9 if sent >= 0 else NEVER_RECEIVED_S


@inline_kernel
def _received(swarm: SwarmState, track: FlightTrack, sent: int, row: int) -> Array:
    """Odometry vector (13,) that UAV number `row` sent at tick `sent`; zeros when there is none."""
    if sent < 0 or row < 0:
        return swarm.nothing
    return track.reported[sent, row]


@inline_kernel
def inputs_of(
    swarm: SwarmState,
    wiring: Wiring,
    track: FlightTrack,
    tick: int,
    row: int,
    disturbances: Disturbances | None,
) -> AgentInputs:
    """What UAV number `row` knows at `tick`: what was sent at the tick before, or longer ago if that got lost."""
    parent = wiring.parent[row]
    from_parent, from_leader = tick - 1, tick - 1
    if disturbances is not None:
        received = disturbances.received[tick, row]
        from_parent, from_leader = received[0], received[1]
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
    landing = tick * wiring.dt_ns >= wiring.landing_ns
    return AgentInputs(
        track.odometry[tick, row],
        _received(swarm, track, from_parent, parent),
        _age(tick, from_parent, wiring.dt_ns) if parent >= 0 else NEVER_RECEIVED_S,
        _received(swarm, track, from_leader, wiring.leader if pinned else -1),
        _age(tick, from_leader, wiring.dt_ns) if pinned else NEVER_RECEIVED_S,
        estimates,
        ages,
        swarm.near[row, : swarm.near_count[row]],
        (behind * wiring.dt_ns) * 1e-9,
        MODE_LAND if landing else MODE_FORMATION,
        (tick * wiring.dt_ns) * 1e-9,
    )


@inline_kernel
def since_epoch(wiring: Wiring, tick: int) -> float:
    """Seconds since the latest epoch: the first one, or the begin of the landing."""
    now_ns = tick * wiring.dt_ns
    if now_ns >= wiring.landing_ns:
        now_ns -= wiring.landing_ns
    return now_ns * 1e-9


@kernel
def sense(
    swarm: SwarmState,
    wiring: Wiring,
    track: FlightTrack,
    tick: int,
    disturbances: Disturbances | None,
) -> None:
    """Measure every UAV's odometry, and the near objects when the sensor's turn has come."""
    size = swarm.bodies.shape[0]
    true = track.odometry if disturbances is None else track.truth
    for row in range(size):
        store_odometry(true[tick, row], swarm.bodies[row], wiring.plant)
    if disturbances is not None:
        for row in range(size):
            store(track.odometry[tick, row], 0, _believed(track, tick, row, wiring, disturbances))
    if tick % wiring.near_every == 0:
        _sense_near(swarm, wiring, track, tick, disturbances)


@kernel
def _sense_near(
    swarm: SwarmState,
    wiring: Wiring,
    track: FlightTrack,
    tick: int,
    disturbances: Disturbances | None,
) -> None:
    true = track.odometry[tick] if disturbances is None else track.truth[tick]
    obstacles = obstacles_at(wiring, tick)
    store_objects(true, obstacles, swarm.objects)
    for row in range(true.shape[0]):
        count = store_near(
            row, true, obstacles, swarm.objects, wiring.keep_outs, wiring.range_m, swarm.near[row]
        )
        swarm.near_count[row] = count
        if disturbances is not None:
            samples = disturbances.sensor_samples[tick // wiring.near_every, row]
            seen = track.odometry[tick, row]
            near = add_sensor_noise(
                swarm.near[row, :count], true[row], seen, samples, disturbances.sensor_noise
            )
            swarm.near[row, :count] = near


@kernel
def _believed(
    track: FlightTrack, tick: int, row: int, wiring: Wiring, disturbances: Disturbances
) -> Array:
    """Odometry vector (13,) that UAV number `row` sees, from its true one."""
    measured = measured_odometry(
        track.truth[tick, row],
        track.truth[max(tick - disturbances.position_noise.delay, 0), row],
        track.truth[max(tick - disturbances.position_noise.compensated, 0), row],
        disturbances.position_errors[row],
        disturbances.position_samples[tick, row],
        tick,
        wiring.dt_ns * 1e-9,
        disturbances.position_noise,
    )
    add_jumps(measured, tick, row, disturbances.jumps)
    return measured


@inline_kernel
def _dead(tick: int, row: int, disturbances: Disturbances) -> bool:
    """Whether the process of UAV number `row` has been killed."""
    return tick >= disturbances.ends_at[row]


@inline_kernel
def advance_plant(
    swarm: SwarmState,
    wiring: Wiring,
    track: FlightTrack,
    tick: int,
    row: int,
    disturbances: Disturbances | None,
) -> None:
    """One control period of UAV number `row` under the wrench that it has just commanded."""
    plant = swarm.plants[row]
    if disturbances is not None:
        samples = disturbances.gust_samples[tick, row]
        gust_step(disturbances.gust[row], plant.wind, samples, tick, disturbances.gusts)
        if _dead(tick, row, disturbances):
            stop(swarm.bodies[row], wiring.plant)
            return
    t, dt = (tick * wiring.dt_ns) * 1e-9, wiring.dt_ns * 1e-9
    advance_with(swarm.bodies[row], track.wrench[tick, row], t, dt, plant, swarm.waves)


@kernel
def _fly(
    first: int,
    count: int,
    wiring: Wiring,
    swarm: SwarmState,
    track: FlightTrack,
    disturbances: Disturbances | None,
) -> None:
    """Ticks first .. first + count - 1 of the whole swarm into `track`.

    What depends on `disturbances` is compiled only for flights that have some: numba drops a branch on None.
    """
    wiring, swarm, track = borrowed(wiring), borrowed(swarm), borrowed(track)
    dt = wiring.dt_ns * 1e-9
    for tick in range(first, first + count):
        t = since_epoch(wiring, tick)
        sense(swarm, wiring, track, tick, disturbances)
        for row in range(swarm.bodies.shape[0]):
            if disturbances is not None and _dead(tick, row, disturbances):
                note_silence(track, tick, row)
                continue
            inputs = inputs_of(swarm, wiring, track, tick, row, disturbances)
            swarm.states[row], out = inlined_step(
                swarm.states[row], inputs, None, t, dt, swarm.configs[row]
            )
            note(track, tick, row, out)
        for row in range(swarm.bodies.shape[0]):  # apart: the code of both does not fit the cache
            advance_plant(swarm, wiring, track, tick, row, disturbances)


@kernel
def _step_guided(
    tick: int,
    wiring: Wiring,
    swarm: SwarmState,
    track: FlightTrack,
    velocities: Array,
    disturbances: Disturbances | None,
) -> None:
    """One tick, in which the followers have velocities (N, 3) [m/s, ENU] of another law."""
    wiring, swarm, track = borrowed(wiring), borrowed(swarm), borrowed(track)
    t, dt = (tick * wiring.dt_ns) * 1e-9, wiring.dt_ns * 1e-9
    for row in range(swarm.bodies.shape[0]):
        if disturbances is not None and _dead(tick, row, disturbances):
            note_silence(track, tick, row)
            continue
        inputs = inputs_of(swarm, wiring, track, tick, row, disturbances)
        if row == wiring.leader:
            swarm.states[row], out = step(swarm.states[row], inputs, t, dt, swarm.configs[row])
        else:
            wanted = (velocities[row, 0], velocities[row, 1], velocities[row, 2])
            swarm.states[row], out = guided_step(
                swarm.states[row], inputs, wanted, t, dt, swarm.configs[row]
            )
        note(track, tick, row, out)
    for row in range(swarm.bodies.shape[0]):
        advance_plant(swarm, wiring, track, tick, row, disturbances)


def _guided_loop(scenario: Scenario) -> Loop:
    """The loop of a flight whose followers fly by a law from a file; Python between two ticks."""
    rows = {uav: row for row, uav in enumerate(scenario.uav_ids)}
    laws = [(rows[uav], UavLaw.of(scenario, uav)) for uav in scenario.followers]
    received = {
        (row, sender): last_state_received(scenario, law.uav, sender)
        for row, law in laws
        for sender in law.senders
    }
    velocities = np.zeros((len(rows), 3))

    def heard(track: FlightTrack, tick: int, row: int, law: UavLaw) -> Iterator[Heard]:
        for sender in law.senders:
            sent = int(received[row, sender][tick])
            if sent >= 0:
                age_s = ((tick - sent) * scenario.dt_ns) * 1e-9
                yield Heard(sender, track.reported[sent, rows[sender]], age_s)

    def loop(
        first: int,
        count: int,
        wiring: Wiring,
        swarm: SwarmState,
        track: FlightTrack,
        disturbances: Disturbances | None,
    ) -> None:
        for tick in range(first, first + count):
            t = (tick * wiring.dt_ns) * 1e-9
            sense(swarm, wiring, track, tick, disturbances)
            for row, law in laws:
                near = swarm.near[row, : swarm.near_count[row]]
                found = heard(track, tick, row, law)
                velocities[row] = law.velocity(t, track.odometry[tick, row], found, near)
            _step_guided(tick, wiring, swarm, track, velocities, disturbances)

    return loop


@kernel
def _starts(configs: Sequence[AgentConfig], seen: Array) -> MutableSequence[AgentState]:
    states = KernelList()
    for row in range(len(configs)):
        states.append(initial_state(seen[row], configs[row]))
    return states


def _first_seen(truth: Array, dt: float, disturbances: Disturbances | None) -> Array:
    """Odometry vectors (N, 13) that the UAVs see at the first tick, from the true ones."""
    if disturbances is None:
        return truth
    kind = disturbances.position_noise
    rows = [
        measured_odometry(
            own, own, own, initial_error(kind), disturbances.position_samples[0, row], 0, dt, kind
        )
        for row, own in enumerate(truth)
    ]
    return np.stack(rows)


def swarm_of(
    scenario: Scenario,
    wiring: Wiring,
    disturbances: Disturbances | None,
    like: SwarmState | None = None,
) -> SwarmState:
    """The UAVs of a scenario before the first tick; `like` has the constants of those that differ in starts only."""
    ids = scenario.uav_ids
    configs: Sequence[AgentConfig]
    plants: Sequence[PlantConfig]
    if like is None:
        configs = kernel_list([agent_config(scenario, uav_id) for uav_id in ids])
    else:
        configs = like.configs
    if like is None or disturbances is not None:  # gusts are written into the wind of a plant
        plants = kernel_list([plant_config(scenario, uav_id) for uav_id in ids])
    else:
        plants = like.plants
    bodies = start_states(scenario, plants)
    seen = _first_seen(measure_all(bodies, plants), wiring.dt_ns * 1e-9, disturbances)
    size, objects = len(ids), len(ids) + wiring.obstacles.shape[1]
    received = wiring.neighbours.shape
    return SwarmState(
        configs,
        plants,
        _starts(configs, seen),
        bodies,
        np.zeros((objects, NEAR_COLUMNS)),
        np.zeros((size, objects - 1, NEAR_COLUMNS)),
        np.zeros(size, dtype=np.int64),
        np.zeros((*received, ODOMETRY_SIZE)),
        np.zeros(received),
        np.zeros(ODOMETRY_SIZE),
        no_waves(wiring.substeps),
    )


def slots_at_start(scenario: Scenario) -> Mapping[int, int]:
    """The slots by the positions that the UAVs measure at the first tick; empty where each has its own."""
    if not are_open(scenario):
        return {}
    world = World(scenario)
    return optimal_slots(scenario, {uav: world.odometry(uav)[0:3] for uav in world.ids})


def fly(
    scenario: Scenario,
    progress: Callable[[int, int], None] | None = None,
    room: HeadlessFlight | None = None,
) -> HeadlessFlight:
    """Fly a scenario headless.

    Args:
        scenario: what to fly.
        progress: called with (ticks done, ticks in all) now and then.
        room: an earlier flight, whose track is overwritten where it fits; constants of its UAVs are used again
            where only the starts differ.

    Returns:
        The whole flight; the same scenario gives the same bytes.
    """
    loop = _fly if scenario.law is None else _guided_loop(scenario)
    return flown(scenario, loop, progress, room)


def flown(
    scenario: Scenario,
    loop: Loop,
    progress: Callable[[int, int], None] | None = None,
    room: HeadlessFlight | None = None,
) -> HeadlessFlight:
    """As `fly`, with the law in `loop`."""
    ticks, size = scenario.ticks, len(scenario.uav_ids)
    slots = slots_at_start(scenario)
    held = with_slots(scenario, slots) if slots else scenario
    like = room if room is not None and held.shares_all_but_starts(room.flown) else None
    wiring = wiring_of(held) if like is None else like.wiring
    disturbances = flight_disturbances(held, wiring.neighbours.shape[1])
    swarm = swarm_of(held, wiring, disturbances, None if like is None else like.swarm)
    track = track_of(ticks, size, with_truth=disturbances is not None, room=room and room.track)
    for first in range(0, ticks, CHUNK_TICKS):
        count = min(CHUNK_TICKS, ticks - first)
        loop(first, count, wiring, swarm, track, disturbances)
        if progress is not None:
            progress(first + count, ticks)
    t_ns = np.arange(ticks, dtype=np.int64) * scenario.dt_ns
    return HeadlessFlight(scenario, t_ns, track, wiring, slots, swarm)
