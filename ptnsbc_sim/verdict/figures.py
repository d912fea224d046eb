"""Further figures of a verdict: input, energy (54), estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_sim.verdict.coverage import missing
from ptnsbc_sim.verdict.error_figures import ValueAt, max_of
from ptnsbc_sim.verdict.formation_error import reference_of
from ptnsbc_sim.verdict.recording import NANO, Recording
from ptnsbc_sim.verdict.track import BLOCK, Series, lengths


@dataclass(frozen=True)
class Effort:
    """The input that one UAV commanded."""

    uav: int
    initial_input: float  # |(force, torque)| at the epoch [N, N m]
    initial_above_hover_n: float  # force at the epoch minus the weight
    peak_input: float  # largest |(force, torque)|
    peak_force_n: float
    peak_at_s: float
    energy: float  # integral of |u|^2 (54) [N^2 s]
    energy_above_hover: float  # the same of the force above the weight, and of the torque
    missing: int  # wrench messages missing of one per odometry sent or per control period


@dataclass(frozen=True)
class EstimatorError:
    """Error of one follower's estimate of the leader's position."""

    uav: int
    at_deadline_m: float | None
    max_after_m: float | None


class _InputFigures:
    """Figures of the inputs of one UAV, which arrive block by block."""

    def __init__(self, recording: Recording, uav: int) -> None:
        self._recording = recording
        scenario = recording.scenario
        self._weight = scenario.vehicle(uav).mass_kg * scenario.world.gravity_m_s2
        self.first: tuple[float, float] | None = None  # |u| and force at the epoch
        self.peak = self.peak_force = -np.inf
        self.peak_at_s = 0.0
        self.energy = self.above_hover = 0.0

    def add(self, block: Series, next_ns: int) -> None:
        """Take the next inputs; the last of them acts until `next_ns`.

        An input acts until the next one that is recorded: a missing message takes no time out of an integral.
        """
        start_ns, end_ns = self._recording.start_ns, self._recording.end_ns
        values = np.asfortranarray(block.values)  # axis by axis in memory
        force, torque = lengths(values[:, :3]), lengths(values[:, 3:])
        edges = np.concatenate((block.t_ns, [next_ns])).clip(start_ns, end_ns)
        seconds = (edges[1:] - edges[:-1]) * NANO
        square = torque**2
        self.energy += float(np.sum((force**2 + square) * seconds))
        self.above_hover += float(np.sum(((force - self._weight) ** 2 + square) * seconds))
        first = block.index(start_ns, "left")
        if first < block.size:
            times = self._recording.times(block.t_ns[first:])
            self._take_peak(times, force[first:], np.hypot(force[first:], torque[first:]))

    def _take_peak(self, times: Array, force: Array, whole: Array) -> None:
        if self.first is None:
            self.first = float(whole[0]), float(force[0])
        self.peak_force = max_of(self.peak_force, force.max())
        peak = int(np.argmax(whole))  # the first NaN, if there is one
        if whole[peak] > self.peak or np.isnan(whole[peak]) > np.isnan(self.peak):
            self.peak, self.peak_at_s = float(whole[peak]), float(times[peak])

    def effort(self, uav: int, missing: int) -> Effort | None:
        """All figures; None when there was no input in the judged time."""
        if self.first is None:
            return None
        return Effort(
            uav=uav,
            initial_input=self.first[0],
            initial_above_hover_n=self.first[1] - self._weight,
            peak_input=self.peak,
            peak_force_n=self.peak_force,
            peak_at_s=self.peak_at_s,
            energy=self.energy,
            energy_above_hover=self.above_hover,
            missing=missing,
        )


def effort(recording: Recording, uav: int) -> Effort | None:
    """Input figures of one UAV; None when its wrench was not recorded."""
    track = recording.wrench.get(uav)
    if track is None:
        return None
    figures = _InputFigures(recording, uav)
    # The last input before the epoch acts at the epoch.
    first = max(track.index(recording.start_ns, "right") - 1, 0)
    end = track.index(recording.end_ns, "right")
    for begin in range(first, end, BLOCK):
        last = min(begin + BLOCK, end)
        following = track.rows(last, last + 1).first_ns if last < end else recording.end_ns
        figures.add(track.rows(begin, last), following)
    return figures.effort(uav, missing(recording, uav, track))


class EstimatorErrors:
    """Errors of the followers' estimates of the leader, as far as they are recorded."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._deadline_s = recording.scenario.gains.estimator.deadline_s
        tracks = recording.estimate
        self._tracks = {u: tracks[u] for u in recording.flown.followers if u in tracks}
        self._at = {uav: ValueAt(self._deadline_s) for uav in self._tracks}
        self._max: dict[int, float] = {}

    def add(self, grid: NDArray[np.int64], positions: dict[int, Array]) -> None:
        """Take the next positions (T, 3) [m] of all UAVs at (T,) [ns]."""
        times = self._recording.times(grid)
        leader = reference_of(self._recording, grid, positions)
        silent = np.zeros(
            grid.shape, dtype=np.bool_
        )  # somebody, not yet noticed: it may be the leader
        for own in self._recording.absences.values():
            for one in own:
                silent |= (grid >= one.begin_ns) & (grid < one.noticed_ns)
        for uav, track in self._tracks.items():
            error = lengths(np.asfortranarray(track.at(grid, 3)) - leader)
            self._at[uav].add(times, error)
            counts = (times >= self._deadline_s) & ~silent
            for absence in self._recording.absences[uav]:
                counts &= (grid < absence.begin_ns) | (grid >= absence.end_ns)
            after = error[counts]
            if after.size:
                self._max[uav] = max_of(self._max.get(uav, -np.inf), after.max())

    def found(self) -> list[EstimatorError]:
        """The errors of every follower."""
        return [EstimatorError(u, self._at[u].value, self._max.get(u)) for u in self._tracks]
