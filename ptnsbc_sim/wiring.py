"""The receivers of every message in a headless flight, and the times of its sensors and its physics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import PLANTS, Array
from ptnsbc_sim.plants.build import obstacle_rows
from ptnsbc_sim.scenario import Scenario, several_parents
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS


class ParentRows(NamedTuple):
    """UAVs with several parents, as rows of the swarm; see `ptnsbc_core.behaviours.neighbour`."""

    several: NDArray[np.int64]  # (N,) how many; 0 for a UAV with one
    rows: NDArray[np.int64]  # (N, P), -1 beyond the last
    weights: Array  # (N, P)
    shifts: Array  # (N, P, 3) [m, ENU]
    stale_s: float


class Wiring(NamedTuple):
    """The receivers of every message, as rows of the swarm; constant during a flight."""

    leader: NDArray[np.int64]  # (N,) row of the leader of each
    parent: NDArray[np.int64]  # (N,) row of the parent, -1 for the leader
    parents: ParentRows
    pinned: NDArray[np.int64]  # (N,) 1 where the leader is heard
    neighbours: NDArray[np.int64]  # (N, K) rows, -1 beyond the last
    neighbour_count: NDArray[np.int64]  # (N,)
    obstacles: Array  # (S, O, 20) bodies at every reading of the sensor; S = 1 where none moves
    keep_outs: Array  # (N, 2) [m] beside and above, see `near_objects`
    range_m: float
    near_every: int
    substeps: int
    dt_ns: int
    plant: int  # PLANT_* of all UAVs
    joins_ns: NDArray[np.int64]  # (N,) until then a UAV holds
    landing_ns: NDArray[np.int64]  # (N,) when a UAV begins to land


@inline_kernel
def obstacles_at(wiring: Wiring, tick: int) -> Array:
    """The obstacles (O, 20) that the near-object sensor meets at `tick`."""
    return wiring.obstacles[min(tick // wiring.near_every, wiring.obstacles.shape[0] - 1)]


def keep_outs_of(scenario: Scenario) -> Array:
    """Keep-outs (N, 2) [m] of all UAVs, beside and above; above 0 where they are spheres."""
    height = scenario.formation.keep_out_height
    beside = [scenario.keep_out_m(uav) for uav in scenario.uav_ids]
    return np.array(
        [(one, one * height if height > 1.0 else 0.0) for one in beside], dtype=np.float64
    )


def wire(wiring: Wiring, scenario: Scenario, uav_id: int) -> None:
    """Give one UAV the edges that it has in another scenario of the same UAVs, in place."""
    row = {one: index for index, one in enumerate(scenario.uav_ids)}
    own, parent = row[uav_id], scenario.communication.parent(uav_id)
    neighbours = scenario.topology.neighbours.get(uav_id, ())
    wiring.leader[own] = row[scenario.leader.id]
    wiring.parent[own] = -1 if parent is None else row[parent]
    wiring.pinned[own] = int(uav_id in scenario.topology.pinned)
    wiring.neighbours[own, : len(neighbours)] = [row[one] for one in neighbours]
    wiring.neighbour_count[own] = len(neighbours)


def _parent_rows(scenario: Scenario) -> ParentRows:
    ids = scenario.uav_ids
    found = [several_parents(scenario, uav_id) for uav_id in ids]
    width = max([1, *(len(one.ids) for one in found if one is not None)])
    size = len(ids)
    parents = ParentRows(
        np.zeros(size, dtype=np.int64),
        np.full((size, width), -1, dtype=np.int64),
        np.zeros((size, width)),
        np.zeros((size, width, 3)),
        float(scenario.communication.stale_s),
    )
    for row, one in enumerate(found):
        if one is not None:
            count = len(one.ids)
            parents.several[row] = count
            parents.rows[row, :count] = [ids.index(uav_id) for uav_id in one.ids]
            parents.weights[row, :count], parents.shifts[row, :count] = one.weights, one.shifts
    return parents


def wiring_of(scenario: Scenario) -> Wiring:
    """The scenario's graph and sensors by row."""
    ids, timing = scenario.uav_ids, scenario.timing
    size, width = len(ids), max(1, *(len(scenario.topology.neighbours.get(uav, ())) for uav in ids))
    readings = np.arange(-(-timing.ticks // scenario.near_every), dtype=np.int64)
    landing_ns = NEVER_NS if scenario.landing_ns is None else scenario.landing_ns
    wiring = Wiring(
        np.zeros(size, dtype=np.int64),
        np.zeros(size, dtype=np.int64),
        _parent_rows(scenario),
        np.zeros(size, dtype=np.int64),
        np.full((size, width), -1, dtype=np.int64),
        np.zeros(size, dtype=np.int64),
        obstacle_rows(scenario, seconds(readings * (scenario.near_every * timing.dt_ns))),
        keep_outs_of(scenario),
        float(scenario.sensor.range_m),
        int(scenario.near_every),
        int(timing.physics_hz // timing.control_hz),
        int(timing.dt_ns),
        PLANTS[scenario.plant.kind],
        np.array([scenario.uav(uav).joins_ns for uav in ids], dtype=np.int64),
        np.array([min(landing_ns, scenario.uav(uav).leaves_ns) for uav in ids], dtype=np.int64),
    )
    for uav in ids:
        wire(wiring, scenario, uav)
    return wiring
