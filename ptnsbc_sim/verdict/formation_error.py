"""The distance of every UAV from its place in the formation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory, places_beside_leader
from ptnsbc_sim.scenario.mission.shapes import moves
from ptnsbc_sim.verdict.recording import NANO, Recording
from ptnsbc_sim.verdict.track import lengths


def formation_errors(
    recording: Recording, grid: NDArray[np.int64], positions: dict[int, Array]
) -> dict[int, Array]:
    """Formation error (T,) [m]: |(p_i - p_1) - o_i(t)|, for the leader |p_1 - p_r(t)|."""
    found = formation_vectors(recording, grid, positions)
    return {uav: lengths(vectors) for uav, vectors in found.items()}


def formation_vectors(
    recording: Recording, grid: NDArray[np.int64], positions: dict[int, Array]
) -> dict[int, Array]:
    """Position (T, 3) [m], ENU, beside the place: (p_i - p_1) - o_i(t), for the leader p_1 - p_r(t).

    Where another UAV leads from its slot o_l, p_1 is p_l - o_l.
    """
    parts = [
        _of_phase(recording, phase.scenario, grid[span], {u: p[span] for u, p in positions.items()})
        for phase, span in recording.by_phase(grid)
    ]
    if len(parts) == 1:
        return parts[0]
    return {uav: np.concatenate([part[uav] for part in parts]) for uav in positions}


def reference_of(
    recording: Recording, grid: NDArray[np.int64], positions: dict[int, Array]
) -> Array:
    """The reference point of the formation (T, 3) [m], ENU: the position of the leader less its slot."""
    found = [
        _reference(phase.scenario, positions[phase.scenario.leader.id][span])
        for phase, span in recording.by_phase(grid)
    ]
    return found[0] if len(found) == 1 else np.concatenate(found)


def _reference(scenario: Scenario, leader: Array) -> Array:
    slot = scenario.offset(scenario.leader.id)
    return leader - slot if slot.any() else leader


def _of_phase(
    recording: Recording,
    scenario: Scenario,
    grid: NDArray[np.int64],
    positions: dict[int, Array],
) -> dict[int, Array]:
    leader = _reference(scenario, positions[scenario.leader.id])
    vector = leader_trajectory(scenario)
    times = np.asarray((grid - recording.first_ns) * NANO, dtype=np.float64)  # of the first leg
    path = reference_positions(vector, times)
    errors, moving = {}, moves(scenario.formation)
    for uav in scenario.uav_ids:
        if uav == scenario.leader.id:
            goal = path + scenario.offset(uav) if scenario.offset(uav).any() else path
        elif moving:
            goal = leader + places_beside_leader(scenario, uav, times)
        else:
            goal = leader + scenario.offset(uav)
        errors[uav] = positions[uav] - goal
    return errors
