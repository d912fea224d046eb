"""The distance of every UAV from its place in the formation, and of its estimate from the leader."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.verdict.recording import Instants, Recording, by_phase, seconds_since
from ptnsbc_sim.verdict.track import ValueAt, lengths, max_of


def formation_errors(recording: Recording, block: Instants) -> dict[int, Array]:
    """Formation error (T,) [m]: |(p_i - p_1) - o_i(t)|, for the leader |p_1 - p_r(t)|."""
    return {uav: lengths(v) for uav, v in formation_vectors(recording, block).items()}


def formation_vectors(recording: Recording, block: Instants) -> dict[int, Array]:
    """Position (T, 3) [m], ENU, beside the place: (p_i - p_1) - o_i(t), for the leader p_1 - p_r(t).

    Where another UAV leads from its slot o_l, p_1 is p_l - o_l.
    """
    times = seconds_since(block.stamps, recording.first_ns)  # of the first leg
    parts = []
    for phase, span in by_phase(recording.phases, block.stamps):
        scenario = phase.scenario
        positions = {uav: place[span] for uav, place in block.positions.items()}
        leader = _reference(scenario, positions[scenario.leader.id])
        path = curve_samples(leader_trajectory(scenario), times[span])[:, :3]
        moving, vectors = scenario.formation.moves, {}
        for uav in scenario.uav_ids:
            slot = scenario.offset(uav)
            if uav == scenario.leader.id:
                goal = path + slot if slot.any() else path
            elif moving:
                goal = leader + places_beside_leader(scenario, uav, times[span])
            else:
                goal = leader + slot
            vectors[uav] = positions[uav] - goal
        parts.append(vectors)
    if len(parts) == 1:
        return parts[0]
    return {uav: np.concatenate([part[uav] for part in parts]) for uav in block.positions}


def _reference(scenario: Scenario, leader: Array) -> Array:
    """The reference point of the formation (T, 3) [m], ENU: the position of the leader less its slot."""
    slot = scenario.offset(scenario.leader.id)
    return leader - slot if slot.any() else leader


@dataclass(frozen=True)
class EstimatorError:
    """Error of one follower's estimate of the leader's position."""

    uav: int
    at_deadline_m: float | None
    max_after_m: float | None


class EstimatorErrors:
    """Errors of the followers' estimates of the leader, as far as they are recorded."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._deadline_s = recording.scenario.gains.estimator.deadline_s
        tracks = recording.estimate
        self._tracks = {u: tracks[u] for u in recording.flown.followers if u in tracks}
        self._at = {uav: ValueAt(self._deadline_s) for uav in self._tracks}
        self._max: dict[int, float] = {}

    def add(self, block: Instants) -> None:
        """Take the next instants."""
        stamps, absences = block.stamps, self._recording.members.absences
        leaders = [
            _reference(phase.scenario, block.positions[phase.scenario.leader.id][span])
            for phase, span in by_phase(self._recording.phases, stamps)
        ]
        leader = leaders[0] if len(leaders) == 1 else np.concatenate(leaders)
        silent = np.zeros(stamps.shape, dtype=np.bool_)
        for away in absences.values():  # somebody, not yet noticed: it may be the leader
            for span in away:
                silent |= (stamps >= span.begin_ns) & (stamps < span.noticed_ns)
        for uav, track in self._tracks.items():
            error = lengths(np.asfortranarray(track.at(stamps, 3)) - leader)
            self._at[uav].add(block.times, error)
            counts = (block.times >= self._deadline_s) & ~silent
            for span in absences[uav]:
                counts &= (stamps < span.begin_ns) | (stamps >= span.end_ns)
            after = error[counts]
            if after.size:
                self._max[uav] = max_of(self._max.get(uav, -np.inf), after.max())

    def results(self) -> list[EstimatorError]:
        """The errors of every follower."""
        return [EstimatorError(u, self._at[u].value, self._max.get(u)) for u in self._tracks]
