"""The distance of every UAV from its place in the formation, and of its estimate from the leader."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.types import Array, Trajectory
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.verdict.recording import Instants, Recording, by_phase, seconds_since
from ptnsbc_sim.verdict.track import ValueAt, lengths, vectors_at


def formation_errors(recording: Recording, block: Instants) -> Array:
    """Formation error (N, T) [m]: |(p_i - p_1) - o_i(t)|, for the leader |p_1 - p_r(t)|."""
    return lengths(formation_vectors(recording, block))


def formation_vectors(recording: Recording, block: Instants) -> Array:
    """Position (3, N, T) [m], ENU, beside the place: (p_i - p_1) - o_i(t), for the leader p_1 - p_r(t).

    Where another UAV leads from its slot o_l, p_1 is p_l - o_l.
    """
    times = seconds_since(block.stamps, recording.first_ns)  # of the first leg
    vectors = np.empty_like(block.positions)
    for phase, span in by_phase(recording.phases, block.stamps):
        scenario, positions = phase.scenario, block.positions[..., span]
        lead = scenario.uav_ids.index(scenario.leader.id)
        places = np.array([scenario.offset(uav) for uav in scenario.uav_ids]).T[..., None]
        numbers, table = leader_trajectory(scenario)
        path = _path(numbers, table.shape, table.tobytes(), times[span].tobytes()) + places[:, lead]
        if scenario.formation.moves:
            moving = (places_beside_leader(scenario, uav, times[span]) for uav in scenario.uav_ids)
            places = np.stack([place.T for place in moving], axis=1)
        goals = _reference(scenario, positions)[:, None] + places
        vectors[..., span] = positions - goals
        vectors[:, lead, span] = positions[:, lead] - path
    return vectors


@lru_cache(maxsize=4)  # the flights of a sweep have one path
def _path(numbers: tuple[float, ...], shape: tuple[int, ...], table: bytes, times: bytes) -> Array:
    """Positions (3, T) [m], ENU, of a trajectory at times (T,) [s]."""
    rows, at = (np.frombuffer(part).copy() if part else np.empty(0) for part in (table, times))
    return curve_samples(Trajectory(numbers, rows.reshape(shape)), at)[:, :3].T.copy()


def _reference(scenario: Scenario, positions: Array) -> Array:
    """The reference point of the formation (3, T) [m], ENU: the position of the leader less its slot."""
    lead = scenario.uav_ids.index(scenario.leader.id)
    return np.asarray(positions[:, lead] - scenario.offset(scenario.leader.id)[:, None])


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
        told = (uav for uav in recording.flown.followers if uav in recording.estimate)
        self._at = {uav: ValueAt(self._deadline_s) for uav in told}
        self._largest = np.full(len(self._at), -np.inf)

    def add(self, block: Instants) -> None:
        """Take the next instants."""
        stamps, absences = block.stamps, self._recording.members.absences
        leader = np.empty((3, stamps.size))
        for phase, span in by_phase(self._recording.phases, stamps):
            leader[:, span] = _reference(phase.scenario, block.positions[..., span])
        counts = block.times >= self._deadline_s
        for away in absences.values():  # somebody, not yet noticed: it may be the leader
            for absence in away:
                counts &= (stamps < absence.begin_ns) | (stamps >= absence.noticed_ns)
        estimates = vectors_at(self._recording.estimate, list(self._at), stamps)
        errors = lengths(estimates - leader[:, None])
        for at, error in zip(self._at.values(), errors, strict=True):
            at.add(block.times, error)
        errors = np.where(counts, errors, -np.inf)
        for row, uav in enumerate(self._at):
            for absence in absences[uav]:
                errors[row, (stamps >= absence.begin_ns) & (stamps < absence.end_ns)] = -np.inf
        self._largest = np.maximum(self._largest, errors.max(axis=1))

    def results(self) -> list[EstimatorError]:
        """The errors of every follower."""
        largest = [None if most == -np.inf else most for most in self._largest.tolist()]
        figures = zip(self._at.items(), largest, strict=True)
        return [EstimatorError(uav, at.value, most) for (uav, at), most in figures]
