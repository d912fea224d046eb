"""How far every UAV is from its place in the formation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import Array
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
    """Position (T, 3) [m], ENU, beside the place: (p_i - p_1) - o_i(t), for the leader p_1 - p_r(t)."""
    scenario = recording.flown
    leader = positions[scenario.leader_id]
    vector = leader_trajectory(scenario)
    times = np.asarray((grid - recording.first_ns) * NANO, dtype=np.float64)  # of the first leg
    path = reference_positions(vector, times)
    errors, moving = {}, moves(scenario.file.formation)
    for uav in scenario.uav_ids:
        if uav == scenario.leader_id:
            goal = path
        elif moving:
            goal = leader + places_beside_leader(scenario, uav, times)
        else:
            goal = leader + scenario.offset(uav)
        errors[uav] = positions[uav] - goal
    return errors
