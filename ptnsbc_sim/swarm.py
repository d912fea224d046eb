"""Headless flight: the whole swarm in one process, by the same kernels and the same tick as the processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableSequence, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.kernel import kernel, kernel_list, referred
from ptnsbc_core.step import initial_state
from ptnsbc_core.types import NEAR_COLUMNS, ODOMETRY_SIZE, AgentConfig, AgentState, Array
from ptnsbc_sim.disturbances.build import Disturbances, VehicleDisturbances, flight_disturbances
from ptnsbc_sim.disturbances.links import last_received_by
from ptnsbc_sim.plants.build import plant_config, start_states
from ptnsbc_sim.plants.contract import no_waves
from ptnsbc_sim.plugins.loop import loop_of
from ptnsbc_sim.plugins.world_plugins import WorldPlugins
from ptnsbc_sim.roles import RoleChange, moved_on, role_changes
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.approach.deadline import turn_of
from ptnsbc_sim.scenario.slots import optimal_slots, with_slots
from ptnsbc_sim.tick import Loop, SwarmState
from ptnsbc_sim.track import FlightTrack, track_of
from ptnsbc_sim.wiring import Wiring, obstacles_at, wire, wiring_of
from ptnsbc_sim.world import World, measure_all

CHUNK_TICKS = 2000


class HeadlessFlight(NamedTuple):
    """A headless flight."""

    scenario: Scenario
    t_ns: NDArray[np.int64]  # (T,)
    swarm: SwarmState  # as it is at the end
    slots: Mapping[int, int]  # of every UAV, decided at the epoch; empty where each has its own

    @property
    def track(self) -> FlightTrack:
        """The record of the flight."""
        return self.swarm.track

    @property
    def flown(self) -> Scenario:
        """The scenario with the slots that the UAVs took."""
        return with_slots(self.scenario, self.slots) if self.slots else self.scenario

    @property
    def truth(self) -> Array:
        """True odometry vectors (T, N, 13), whatever the UAVs believed."""
        return self.track.truth if len(self.track.truth) else self.track.odometry

    def near(self, tick: int, row: int) -> Array:
        """Rows (M, 8) that UAV number `row` saw at a tick that is a multiple of near_every."""
        obstacles, keep_outs = obstacles_at(self.swarm.wiring, tick), self.swarm.wiring.keep_outs
        seen = self.track.odometry[tick, row] if len(self.track.truth) else None
        sensors = WorldPlugins(self.scenario)
        return sensors.near(row, tick, self.truth[tick], seen, obstacles, keep_outs)


@kernel
def _begin(
    seen: Array, configs: Sequence[AgentConfig], states: MutableSequence[AgentState]
) -> None:
    """The states before the first tick of UAVs that see these odometry vectors (N, 13)."""
    for row in range(seen.shape[0]):
        states[row] = initial_state(seen[row], configs[row])


def swarm_of(
    scenario: Scenario,
    wiring: Wiring,
    track: FlightTrack,
    disturbances: Disturbances | None,
    like: SwarmState | None = None,
) -> SwarmState:
    """The UAVs of a scenario before the first tick; `like`: those of others that differ in starts only, to fly anew."""
    ids = scenario.uav_ids
    plants = None if like is None or disturbances is not None else like.plants  # winds change
    plants = plants or kernel_list([plant_config(scenario, uav_id) for uav_id in ids])
    bodies = start_states(scenario, plants)
    seen = measure_all(bodies, plants)
    if disturbances is not None:
        vehicles = (VehicleDisturbances(scenario, uav_id, np.zeros(3)) for uav_id in ids)
        pairs = zip(vehicles, seen, strict=True)
        seen = np.stack([around.measured_odometry(0, truth) for around, truth in pairs])
    if like is None:
        constants = [agent_config(scenario, uav_id) for uav_id in ids]
        first = [initial_state(own, of) for own, of in zip(seen, constants, strict=True)]
        configs, states = kernel_list(constants), kernel_list(first)
    else:
        configs, states = like.configs, like.states
        _begin(seen, configs, states)
    size, others = len(ids), len(ids) - 1 + wiring.obstacles.shape[1]
    received = wiring.neighbours.shape
    return SwarmState(
        wiring,
        track,
        configs,
        plants,
        states,
        bodies,
        np.zeros((size, others, NEAR_COLUMNS)),
        np.zeros(size, dtype=np.int64),
        np.zeros((*received, ODOMETRY_SIZE)),
        np.zeros(received),
        np.zeros((wiring.parents.rows.shape[1], ODOMETRY_SIZE)),
        np.zeros(wiring.parents.rows.shape[1]),
        np.zeros(ODOMETRY_SIZE),
        np.zeros(ODOMETRY_SIZE),
        no_waves(wiring.substeps),
    )


def _take_role(
    change: RoleChange, tick: int, swarm: SwarmState, disturbances: Disturbances | None
) -> None:
    """Have a UAV fly in another place of the graph from `tick` on."""
    scenario, row = change.after, change.after.uav_ids.index(change.uav)
    swarm.configs[row] = agent_config(scenario, change.uav)
    swarm.states[row] = moved_on(swarm.states[row], change)
    wire(swarm.wiring, scenario, change.uav)
    if disturbances is not None:
        received = last_received_by(scenario, change.uav, swarm.wiring.neighbours.shape[1])
        disturbances.received[tick:, row] = received[tick:]


def slots_at_start(scenario: Scenario) -> Mapping[int, int]:
    """The slots by the positions that the UAVs measure at the first tick; empty where each has its own."""
    if not scenario.formation.has_open_slots:
        return {}
    world = World(scenario)
    return optimal_slots(scenario, {uav: world.odometry(uav)[0:3] for uav in world.ids})


def fly(
    scenario: Scenario,
    progress: Callable[[int, int], None] | None = None,
    room: HeadlessFlight | None = None,
    loop: Loop | None = None,
) -> HeadlessFlight:
    """Fly a scenario headless.

    Args:
        scenario: what to fly.
        progress: called with (ticks done, ticks in all) now and then.
        room: an earlier flight, whose track is overwritten where it fits; constants of its UAVs are used again
            where only the starts differ, and their approach turns as theirs does.
        loop: with a law in it, in place of the one that the scenario names.

    Returns:
        The whole flight; the same scenario gives the same bytes.
    """
    ticks, size = scenario.timing.ticks, len(scenario.uav_ids)
    slots = slots_at_start(scenario)
    held = with_slots(scenario, slots) if slots else scenario
    loop = loop or loop_of(held)
    like = room if room is not None and held.shares_all_but_starts(room.flown) else None
    if like is not None and turn_of(held) != like.swarm.configs[0].turn:
        like = None  # the one constant that follows from the starts
    if held.formation.reconfigures:
        like = None  # what a UAV has in common with others changes in flight
    wiring = wiring_of(held) if like is None else like.swarm.wiring
    disturbances = flight_disturbances(held, wiring.neighbours.shape[1])
    track = track_of(ticks, size, with_truth=disturbances is not None, room=room and room.track)
    swarm = swarm_of(held, wiring, track, disturbances, None if like is None else like.swarm)
    bundles = referred(swarm), referred(disturbances)
    changes = role_changes(held)
    for first, end in pairwise(sorted({*range(0, ticks, CHUNK_TICKS), *changes, ticks})):
        for change in changes.get(first, ()):
            _take_role(change, first, swarm, disturbances)
        loop(first, end - first, *bundles)
        if progress is not None:
            progress(end, ticks)
    t_ns = np.arange(ticks, dtype=np.int64) * scenario.timing.dt_ns
    return HeadlessFlight(scenario, t_ns, swarm, slots)
