"""The input of a verdict: plain arrays on one clock, from the simulator, a fleet or real vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import Word, number_of
from ptnsbc_sim.scenario.mission.stream import SetpointError, setpoint_of
from ptnsbc_sim.scenario.slots import are_open, with_slots
from ptnsbc_sim.verdict.phases import Absence, Phase, absences, phases
from ptnsbc_sim.verdict.track import Track

NANO = 1e-9
FORMATION = "form"  # name of the legs that have a deadline
LANDING = "land"


class VerdictError(PtnsbcError):
    """A recording that cannot be judged."""


def with_said(
    scenario: Scenario, epochs: tuple[tuple[int, str], ...]
) -> tuple[Scenario, tuple[tuple[int, str], ...]]:
    """The scenario as its mission was flown, and the epochs (t0 [ns], leg) without what was said of it."""
    legs = tuple(one for one in epochs if number_of(one[1]) is None)
    first_ns = next((t0_ns for t0_ns, leg in legs if leg == FORMATION), None)
    words = sorted(
        Word(number, (t0_ns - first_ns) * NANO)
        for t0_ns, leg in epochs
        if first_ns is not None and (number := number_of(leg)) is not None
    )
    if words and scenario.mission is not None:
        known = [word for word in words if word.number <= len(scenario.mission.legs)]
        scenario = scenario.with_words(sorted(known, key=lambda word: word.at_s))
    return scenario, legs


def with_taken(
    scenario: Scenario, epochs: tuple[tuple[int, str], ...], taken: Sequence[tuple[int, Array]]
) -> Scenario:
    """The scenario whose leader follows the setpoints that it has taken in flight: from when [ns], and (13,) each.

    Raises:
        VerdictError: the leader cannot have followed them.
    """
    first_ns = next((t0_ns for t0_ns, leg in epochs if leg == FORMATION), None)
    if not taken or first_ns is None or not scenario.takes_setpoints:
        return scenario
    try:
        return scenario.with_setpoints(
            setpoint_of((stamp_ns - first_ns) * NANO, values) for stamp_ns, values in taken
        )
    except SetpointError as error:
        raise VerdictError(f"the setpoints that the leader has taken: {error}") from None


def with_landing(
    scenario: Scenario, epochs: tuple[tuple[int, str], ...]
) -> tuple[tuple[int, str], ...]:
    """Epochs (t0 [ns], leg) with the landing of the mission, which every UAV begins by itself."""
    first_ns = next((t0_ns for t0_ns, leg in epochs if leg == FORMATION), None)
    if first_ns is None or scenario.landing_ns is None:
        return epochs
    t0_ns = first_ns + scenario.landing_ns
    before = [leg for begun_ns, leg in epochs if begun_ns <= t0_ns]
    return tuple(sorted((*epochs, (t0_ns, LANDING)))) if before[-1] == FORMATION else epochs


COUNTERS = (
    "avoidance_active_s",
    "saturated_s",
    "holding_s",
    "missed_ticks",  # since the process started
    "priority_violation_max",  # [m/s]
    "deadlock_s",
)
"""Columns of the counters that a UAV publishes on /diagnostics, counted from its start."""


def counter_rise(counters: Track, name: str, start_ns: int, end_ns: int) -> float:
    """Rise of a counter between two instants."""
    column = COUNTERS.index(name)

    def before(end: int) -> float:
        return float(counters.rows(end - 1, end).values[0, column])

    last = counters.index(end_ns, "right")
    if not last:
        return 0.0
    first = counters.index(start_ns, "left") if start_ns > counters.first_ns else 0
    return max(before(last) - (before(first) if first else 0.0), 0.0)


@dataclass(frozen=True)
class Recording:
    """A whole flight."""

    scenario: Scenario
    odometry: Mapping[int, Track]  # (T, 13) per UAV
    wrench: Mapping[int, Track]  # (T, 6) per UAV; may lack UAVs
    estimate: Mapping[int, Track]  # (T, 13) per UAV; may lack UAVs
    counters: Mapping[int, Track]  # (T, 6) per UAV, `COUNTERS`; may lack UAVs
    epochs: tuple[tuple[int, str], ...]  # (t0 [ns], leg), ascending; empty when not recorded
    truth: Mapping[int, Track] = field(default_factory=dict)  # (T, 13) per UAV; simulators only
    # (T, 1) per UAV: odometry messages sent until each stamp, counted by the bridge
    sent: Mapping[int, Track] = field(default_factory=dict)
    latency: Mapping[str, float] = field(default_factory=dict)  # newest figures of the sim node
    leg: int = 0  # which of the formation legs is judged
    # slot of every UAV by the epoch [ns] that decided it; empty where every UAV has its own
    slots: Mapping[int, Mapping[int, int]] = field(default_factory=dict)
    injected: tuple[
        str, ...
    ] = ()  # faults of an operator, in words; those of the scenario are in it
    window_s: float | None = None  # judge only so many seconds after its epoch

    @cached_property
    def forms(self) -> tuple[int, ...]:
        """Epochs [ns] of the formation legs; the stamp of the first message when none was recorded."""
        found = tuple(t0_ns for t0_ns, leg in self.epochs if leg == FORMATION)
        return found or (min(track.first_ns for track in self.odometry.values()),)

    @cached_property
    def first_ns(self) -> int:
        """Epoch of the first formation leg, from which the leader's trajectory is counted."""
        return self.forms[0]

    @cached_property
    def start_ns(self) -> int:
        """Epoch of the leg, from which deadlines are counted."""
        return self.forms[self.leg]

    @cached_property
    def flown(self) -> Scenario:
        """The scenario with the slots that the UAVs took in this leg.

        Raises:
            VerdictError: the slots are open, and those of this leg are not recorded.
        """
        if not are_open(self.scenario):
            return self.scenario
        if self.start_ns not in self.slots:
            raise VerdictError(
                "the recording does not say who takes which slot: expected the slots of the epoch at "
                f"{self.start_ns * NANO:.3f} s"
            )
        return with_slots(self.scenario, self.slots[self.start_ns])

    @cached_property
    def absences(self) -> Mapping[int, tuple[Absence, ...]]:
        """The times during which each UAV did not belong to the formation."""
        return absences(self.scenario, self.estimate, self.first_ns)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the flight, in each of which the graph does not change."""
        return phases(self.flown, self.absences, self.first_ns)

    def by_phase(self, grid: NDArray[np.int64]) -> Iterator[tuple[Phase, slice]]:
        """The phases of the instants (T,) [ns], and which instants are in each."""
        cuts = np.searchsorted(grid, [phase.begin_ns for phase in self.phases[1:]]).tolist()
        for phase, (first, end) in zip(self.phases, pairwise([0, *cuts, len(grid)]), strict=True):
            if first < end:
                yield phase, slice(first, end)

    def slot(self, uav: int) -> int:
        """The slot that a UAV took in this leg."""
        return self.slots.get(self.start_ns, {}).get(uav, uav)

    @cached_property
    def due_ns(self) -> int:
        """The time at which the leg should end: at the next epoch, the end of the window, or the end of the flight."""
        return self._ended(self.first_ns + self.scenario.timing.ticks * self.scenario.timing.dt_ns)

    @cached_property
    def staying(self) -> tuple[int, ...]:
        """The UAVs that have not gone for good; all when nobody stays."""
        gone = {uav for uav, away in self.absences.items() if away and away[-1].for_good}
        return (
            tuple(uav for uav in self.scenario.uav_ids if uav not in gone) or self.scenario.uav_ids
        )

    @cached_property
    def last_ns(self) -> int:
        """The last instant that is recorded of all UAVs which have not gone for good: bridges end with the landing."""
        return min(self.odometry[uav].last_ns for uav in self.staying)

    @cached_property
    def clock(self) -> Track:
        """The odometry whose stamps are the judged instants: of the leader, or of a UAV that stays when it has gone."""
        uav = self.scenario.leader.id
        if self.odometry[uav].last_ns < self.last_ns and uav not in self.staying:
            uav = self.staying[0]
        return self.odometry[uav]

    @cached_property
    def end_ns(self) -> int:
        """The end of the judged time: with the leg, or at the last instant that is recorded of all UAVs."""
        return self._ended(self.last_ns)

    def _ended(self, last_ns: int) -> int:
        later = [t0_ns for t0_ns, _ in self.epochs if t0_ns > self.start_ns]
        if self.window_s is not None:
            later.append(self.start_ns + round(self.window_s / NANO))
        return min([last_ns, *later])

    @property
    def samples(self) -> int:
        """Number of judged instants."""
        first, end = self.clock.span(self.start_ns, self.end_ns)
        return end - first

    def grids(self) -> Iterator[NDArray[np.int64]]:
        """The judged instants, block by block: the leader's stamps from the epoch to the end of the leg."""
        if self.samples < 2:
            raise VerdictError(
                "the recording holds no formation flight: expected odometry of the leader after "
                f"the epoch at {self.start_ns * NANO:.3f} s"
            )
        yield from self.grids_between(self.start_ns, self.end_ns)

    def grids_between(self, start_ns: int, end_ns: int) -> Iterator[NDArray[np.int64]]:
        """The leader's stamps between two times, both included, block by block."""
        for block in self.clock.blocks(*self.clock.span(start_ns, end_ns)):
            yield block.t_ns

    @property
    def other_legs_ns(self) -> list[tuple[int, int]]:
        """Begin and end [ns] of the legs that have no deadline, as far as they are recorded; none in a window."""
        if self.window_s is not None:
            return []
        last_ns = self.last_ns
        ends = [*(t0_ns for t0_ns, _ in self.epochs[1:]), last_ns]
        spans = zip(self.epochs, ends, strict=False)  # without epochs there are no spans
        found = [
            (t0_ns, min(end_ns, last_ns)) for (t0_ns, leg), end_ns in spans if leg != FORMATION
        ]
        return [(t0_ns, end_ns) for t0_ns, end_ns in found if self.first_ns <= t0_ns <= end_ns]

    def grid(self) -> NDArray[np.int64]:
        """All judged instants at once, for short flights."""
        return np.concatenate(list(self.grids()))

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return np.asarray((stamps - self.start_ns) * NANO, dtype=np.float64)

    def since_first(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch of the first formation leg."""
        return np.asarray((stamps - self.first_ns) * NANO, dtype=np.float64)

    @property
    def judged_by(self) -> str:
        """The source of positions: `truth` where it is recorded of all UAVs, else `odometry`."""
        return "truth" if all(uav in self.truth for uav in self.scenario.uav_ids) else "odometry"

    def positions(self, grid: NDArray[np.int64]) -> dict[int, Array]:
        """Position (T, 3) [m], ENU, of every UAV on the grid, axis by axis in memory."""
        source = self.truth if self.judged_by == "truth" else self.odometry
        return {uav: np.asfortranarray(source[uav].at(grid, 3)) for uav in self.scenario.uav_ids}


def require_all_uavs(recording: Recording) -> None:
    """Raise VerdictError when a UAV of the scenario is missing."""
    missing = [uav for uav in recording.scenario.uav_ids if uav not in recording.odometry]
    if missing:
        names = ", ".join(f"/uav{uav}/odom" for uav in missing)
        raise VerdictError(f"no message on {names}: expected odometry of every UAV in the scenario")


def tolerance_of(recording: Recording, given: float | None) -> float:
    """Limit of the error at the deadline [m]: the given one, or that of the scenario."""
    return recording.scenario.formation.tolerance_m if given is None else given
