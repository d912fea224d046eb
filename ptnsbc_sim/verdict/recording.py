"""The input of a verdict: plain arrays on one clock, from the simulator, a fleet or real vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import Word, number_of
from ptnsbc_sim.scenario.mission.stream import SetpointError, setpoint_of
from ptnsbc_sim.scenario.slots import with_slots
from ptnsbc_sim.verdict.members import Members, Phase
from ptnsbc_sim.verdict.track import Track

NANO = 1e-9
FORMATION = "form"  # name of the legs that have a deadline
LANDING = "land"

Epochs = tuple[tuple[int, str], ...]  # t0 [ns] and leg, ascending


class VerdictError(PtnsbcError):
    """A recording that cannot be judged."""


def first_formation_ns(epochs: Epochs) -> int | None:
    """The epoch [ns] of the first formation leg; None without one."""
    return next((t0_ns for t0_ns, leg in epochs if leg == FORMATION), None)


def with_said(scenario: Scenario, epochs: Epochs) -> tuple[Scenario, Epochs]:
    """The scenario as its mission was flown, and the epochs without what was said of it."""
    legs = tuple(epoch for epoch in epochs if number_of(epoch[1]) is None)
    first_ns = first_formation_ns(legs)
    words = sorted(
        Word(number, (t0_ns - first_ns) * NANO)
        for t0_ns, leg in epochs
        if first_ns is not None and (number := number_of(leg)) is not None
    )
    if words and scenario.mission is not None:
        known = [word for word in words if word.number <= len(scenario.mission.legs)]
        scenario = scenario.with_words(sorted(known, key=lambda word: word.at_s))
    return scenario, legs


def with_taken(scenario: Scenario, epochs: Epochs, taken: Sequence[tuple[int, Array]]) -> Scenario:
    """The scenario whose leader follows the setpoints that it has taken in flight: from when [ns], and (13,) each.

    Raises:
        VerdictError: the leader cannot have followed them.
    """
    first_ns = first_formation_ns(epochs)
    if not taken or first_ns is None or not scenario.takes_setpoints:
        return scenario
    try:
        return scenario.with_setpoints(
            setpoint_of((stamp_ns - first_ns) * NANO, values) for stamp_ns, values in taken
        )
    except SetpointError as error:
        raise VerdictError(f"the setpoints that the leader has taken: {error}") from None


def with_landing(scenario: Scenario, epochs: Epochs) -> Epochs:
    """Epochs with the landing of the mission, which every UAV begins by itself."""
    first_ns = first_formation_ns(epochs)
    if first_ns is None or scenario.landing_ns is None:
        return epochs
    t0_ns = first_ns + scenario.landing_ns
    before = [leg for begun_ns, leg in epochs if begun_ns <= t0_ns]
    return tuple(sorted((*epochs, (t0_ns, LANDING)))) if before[-1] == FORMATION else epochs


def seconds(stamps: NDArray[np.int64], zero_ns: int) -> Array:
    """Seconds (T,) after an instant."""
    return np.asarray((stamps - zero_ns) * NANO, dtype=np.float64)


class Instants(NamedTuple):
    """Instants that are judged together."""

    stamps: NDArray[np.int64]  # (T,) [ns]
    times: Array  # (T,) [s] after the epoch of the leg
    positions: dict[int, Array]  # (T, 3) [m], ENU, of every UAV, axis by axis in memory


@dataclass(frozen=True)
class Recording:
    """A whole flight, of which one leg is judged."""

    scenario: Scenario
    odometry: Mapping[int, Track]  # (T, 13) per UAV
    wrench: Mapping[int, Track]  # (T, 6) per UAV; may lack UAVs
    estimate: Mapping[int, Track]  # (T, 13) per UAV; may lack UAVs
    counters: Mapping[int, Track]  # (T, 6) per UAV, `COUNTERS`; may lack UAVs
    epochs: Epochs  # empty when not recorded
    truth: Mapping[int, Track] = field(default_factory=dict)  # (T, 13) per UAV; simulators only
    # (T, 1) per UAV: odometry messages sent until each stamp, counted by the bridge
    sent: Mapping[int, Track] = field(default_factory=dict)
    latency: Mapping[str, float] = field(default_factory=dict)  # newest figures of the sim node
    leg: int = 0  # which of the formation legs is judged
    # slot of every UAV by the epoch [ns] that decided it; empty where every UAV has its own
    slots: Mapping[int, Mapping[int, int]] = field(default_factory=dict)
    # faults of an operator, in words; those of the scenario are in it
    injected: tuple[str, ...] = ()
    window_s: float | None = None  # judge only so many seconds after its epoch

    @cached_property
    def forms(self) -> tuple[int, ...]:
        """Epochs [ns] of the formation legs; the stamp of the first message when none was recorded."""
        forms = tuple(t0_ns for t0_ns, leg in self.epochs if leg == FORMATION)
        return forms or (min(track.first_ns for track in self.odometry.values()),)

    @property
    def first_ns(self) -> int:
        """Epoch of the first formation leg, from which the leader's trajectory is counted."""
        return self.forms[0]

    @property
    def start_ns(self) -> int:
        """Epoch of the leg, from which deadlines are counted."""
        return self.forms[self.leg]

    @cached_property
    def flown(self) -> Scenario:
        """The scenario with the slots that the UAVs took in this leg.

        Raises:
            VerdictError: the slots are open, and those of this leg are not recorded.
        """
        if not self.scenario.formation.has_open_slots:
            return self.scenario
        if self.start_ns not in self.slots:
            raise VerdictError(
                "the recording does not say who takes which slot: expected the slots of the epoch at "
                f"{self.start_ns * NANO:.3f} s"
            )
        return with_slots(self.scenario, self.slots[self.start_ns])

    @cached_property
    def members(self) -> Members:
        """Members of the formation, and their times."""
        return Members(self.scenario, self.estimate, self.first_ns)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the flight, in each of which the graph does not change."""
        return self.members.phases(self.flown)

    @cached_property
    def last_ns(self) -> int:
        """The last instant that is recorded of all UAVs which have not gone for good: bridges end with the landing."""
        return min(self.odometry[uav].last_ns for uav in self.members.staying)

    @cached_property
    def clock(self) -> Track:
        """The odometry whose stamps are the judged instants: of the leader, or of a UAV that stays when it has gone."""
        uav, staying = self.scenario.leader.id, self.members.staying
        if self.odometry[uav].last_ns < self.last_ns and uav not in staying:
            uav = staying[0]
        return self.odometry[uav]

    @cached_property
    def end_ns(self) -> int:
        """The end of the judged time: with the leg, or at the last instant that is recorded of all UAVs."""
        return self.cut_off(self.last_ns)

    def cut_off(self, last_ns: int) -> int:
        """An end of the flight [ns], or that of the leg before it: the next epoch, or the end of the window."""
        later = [t0_ns for t0_ns, _ in self.epochs if t0_ns > self.start_ns]
        if self.window_s is not None:
            later.append(self.start_ns + round(self.window_s / NANO))
        return min([last_ns, *later])

    @property
    def samples(self) -> int:
        """Number of judged instants."""
        first, end = self.clock.span(self.start_ns, self.end_ns)
        return end - first

    @property
    def judged_by(self) -> str:
        """The source of positions: `truth` where it is recorded of all UAVs, else `odometry`."""
        return "truth" if all(uav in self.truth for uav in self.scenario.uav_ids) else "odometry"

    def at(self, stamps: NDArray[np.int64]) -> Instants:
        """Times and positions at instants (T,) [ns], ascending."""
        source = self.truth if self.judged_by == "truth" else self.odometry
        positions = {
            uav: np.asfortranarray(source[uav].at(stamps, 3)) for uav in self.scenario.uav_ids
        }
        return Instants(stamps, seconds(stamps, self.start_ns), positions)

    def blocks(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Instants]:
        """The instants of the clock between two times, both included: by default those of the leg.

        Raises:
            VerdictError: the leg is asked for, and nothing of it is recorded.
        """
        if start_ns is None and self.samples < 2:
            raise VerdictError(
                "the recording holds no formation flight: expected odometry of the leader after "
                f"the epoch at {self.start_ns * NANO:.3f} s"
            )
        begin_ns = self.start_ns if start_ns is None else start_ns
        last_ns = self.end_ns if end_ns is None else end_ns
        for block in self.clock.blocks(*self.clock.span(begin_ns, last_ns)):
            yield self.at(block.t_ns)


def whole(recording: Recording) -> Instants:
    """All judged instants at once, for short flights; errors as of `blocks`."""
    return recording.at(np.concatenate([block.stamps for block in recording.blocks()]))


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


def require_all_uavs(recording: Recording) -> None:
    """Raise VerdictError when a UAV of the scenario is missing."""
    missing = [uav for uav in recording.scenario.uav_ids if uav not in recording.odometry]
    if missing:
        names = ", ".join(f"/uav{uav}/odom" for uav in missing)
        raise VerdictError(f"no message on {names}: expected odometry of every UAV in the scenario")


def tolerance_of(recording: Recording, given: float | None) -> float:
    """Limit of the error at the deadline [m]: the given one, or that of the scenario."""
    return recording.scenario.formation.tolerance_m if given is None else given
