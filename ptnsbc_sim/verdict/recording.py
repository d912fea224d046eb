"""The input of a verdict: plain arrays on one clock, from the simulator, a fleet or real vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.counters import COUNTERS, counters_of, status_every
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS
from ptnsbc_sim.scenario.mission.legs import Word, number_of
from ptnsbc_sim.scenario.mission.stream import SetpointError, setpoint_of
from ptnsbc_sim.scenario.slots import Formations, Membership, changed, with_slots
from ptnsbc_sim.verdict.track import Together, Track, together, vectors_at

if TYPE_CHECKING:
    from ptnsbc_sim.swarm import HeadlessFlight


FORMATION = "form"  # name of the legs that have a deadline
LANDING = "land"

Epochs = tuple[tuple[int, str], ...]  # t0 [ns] and leg, ascending


class Absence(NamedTuple):
    """A span in which a UAV did not belong to the formation."""

    begin_ns: int
    end_ns: int  # NEVER_NS: it did not come back
    planned: bool  # by the scenario; else it was silent
    noticed_ns: int  # when the others go on without it

    @property
    def for_good(self) -> bool:
        """True if the UAV did not come back."""
        return self.end_ns >= NEVER_NS

    def text(self, first_ns: int) -> str:
        """In words; times in seconds after the first epoch."""
        begin, end = (seconds(t_ns - first_ns) for t_ns in (self.begin_ns, self.end_ns))
        if self.for_good:
            return f"{'left' if self.planned else 'lost'} at {begin:.2f} s"
        back = f"lost at {begin:.2f} s, back at {end:.2f} s"
        return f"joined at {end:.2f} s" if self.planned else back


class Phase(NamedTuple):
    """A span in which the graph does not change; it lasts until the next one begins."""

    begin_ns: int
    scenario: Scenario
    absent: frozenset[int]
    moved: frozenset[int]  # UAVs with another parent, slot or lead than in the phase before


def absences(
    scenario: Scenario, tracks: Mapping[int, Track], first_ns: int
) -> dict[int, tuple[Absence, ...]]:
    """The absences of every UAV; none unless UAVs may come and go."""
    found: dict[int, tuple[Absence, ...]] = {uav: () for uav in scenario.uav_ids}
    if not scenario.formation.reconfigures:
        return found
    last_ns = max((track.last_ns for track in tracks.values() if track.size), default=first_ns)
    # Processes go on until all have landed.
    last_ns = min(last_ns, first_ns + scenario.timing.ticks * scenario.timing.dt_ns)
    for uav in scenario.uav_ids:
        spans = []
        if scenario.uav(uav).joins_ns:
            spans.append(Absence(first_ns, first_ns + scenario.uav(uav).joins_ns, True, first_ns))
        left_ns = first_ns + scenario.uav(uav).leaves_ns
        if left_ns <= last_ns:
            spans.append(Absence(left_ns, NEVER_NS, True, left_ns))
        if uav in tracks:
            silences = _silences(scenario, tracks[uav], first_ns, last_ns)
            # Through bridges one that has left is silent when it has landed.
            spans += [one for one in silences if one.begin_ns < left_ns]
        found[uav] = tuple(sorted(spans))
    return found


def _silences(scenario: Scenario, track: Track, first_ns: int, last_ns: int) -> list[Absence]:
    stale_ns, dt_ns = nanoseconds(scenario.communication.stale_s), scenario.timing.dt_ns

    def silence(heard_ns: int, again_ns: int) -> Absence:
        return Absence(heard_ns + dt_ns, again_ns, False, heard_ns + dt_ns + stale_ns)

    stamps = np.concatenate(([first_ns], track.t_ns[slice(*track.span(first_ns + 1, last_ns))]))
    gaps = np.flatnonzero(np.diff(stamps) > stale_ns).tolist()
    spans = [silence(int(stamps[k]), int(stamps[k + 1]) + dt_ns) for k in gaps]
    if last_ns - stamps[-1] > stale_ns:
        spans.append(silence(int(stamps[-1]), NEVER_NS))
    return spans


class Members:
    """The members of the formation over a flight: nobody comes or goes unless the scenario says that UAVs may.

    `tracks` hold what each UAV sent at every tick; UAVs without a track count as there.
    """

    def __init__(self, scenario: Scenario, tracks: Mapping[int, Track], first_ns: int) -> None:
        self.absences = absences(scenario, tracks, first_ns)
        self._first_ns = first_ns

    @property
    def staying(self) -> tuple[int, ...]:
        """The UAVs that have not gone for good; all when nobody stays."""
        gone = {uav for uav, away in self.absences.items() if away and away[-1].for_good}
        return tuple(uav for uav in self.absences if uav not in gone) or tuple(self.absences)

    def at(self, t_ns: int) -> set[int]:
        """The UAVs that belonged to the formation at an instant [ns]."""
        return {
            uav
            for uav, away in self.absences.items()
            if not any(span.begin_ns <= t_ns < span.end_ns for span in away)
        }

    def expected(self, uav: int, t_ns: int) -> bool:
        """True unless a UAV comes after an instant [ns], or has left before it, as the scenario has it."""
        away = self.absences[uav]
        return not any(span.planned and span.begin_ns <= t_ns < span.end_ns for span in away)

    def lost(self, uav: int) -> bool:
        """True if a UAV was lost in flight and did not come back."""
        away = self.absences[uav]
        return bool(away) and away[-1].for_good and not away[-1].planned

    def text(self, uav: int) -> str:
        """Times at which a UAV came and went, in words; empty when it was there all the time."""
        return ", ".join(span.text(self._first_ns) for span in self.absences[uav])

    def phases(self, scenario: Scenario) -> tuple[Phase, ...]:
        """The phases of the flight of a scenario with the slots that the UAVs took."""
        phases = [Phase(self._first_ns, scenario, frozenset(), frozenset())]
        spans = [(uav, span) for uav, away in self.absences.items() for span in away]
        if not spans:
            return tuple(phases)
        formations, before = Formations(scenario), scenario
        instants = {t_ns for _, span in spans for t_ns in (span.noticed_ns, span.end_ns)}
        for t_ns in sorted(instants - {NEVER_NS}):
            absent = frozenset(uav for uav, span in spans if span.noticed_ns <= t_ns < span.end_ns)
            earlier = frozenset(uav for uav, span in spans if span.noticed_ns <= t_ns)
            after = formations.of(Membership(absent, earlier - absent)) or before
            there = set(scenario.uav_ids) - absent - phases[-1].absent
            moved = frozenset(uav for uav in there if changed(before, after, uav)[0])
            phases.append(Phase(t_ns, after, absent, moved))
            before = after
        begins_anew = len(phases) > 1 and phases[1].begin_ns == self._first_ns
        return tuple(phases[1:] if begins_anew else phases)


def by_phase(phases: Sequence[Phase], stamps: NDArray[np.int64]) -> Iterator[tuple[Phase, slice]]:
    """The phases of instants (T,) [ns], ascending, and which instants are in each."""
    cuts = stamps.searchsorted([phase.begin_ns for phase in phases[1:]]).tolist()
    for phase, (first, end) in zip(phases, pairwise([0, *cuts, len(stamps)]), strict=True):
        if first < end:
            yield phase, slice(first, end)


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
        Word(number, seconds(t0_ns - first_ns))
        for t0_ns, leg in epochs
        if first_ns is not None and (number := number_of(leg)) is not None
    )
    if words and scenario.mission is not None:
        known = [word for word in words if word.number <= len(scenario.mission.legs)]
        scenario = scenario.with_words(sorted(known, key=lambda word: word.at_s))
    return scenario, legs


def with_taken(scenario: Scenario, epochs: Epochs, taken: Sequence[tuple[int, Array]]) -> Scenario:
    """The scenario whose leader follows the setpoints that it has taken in flight: from when [ns], and (13,) each."""
    first_ns = first_formation_ns(epochs)
    if not taken or first_ns is None or not scenario.takes_setpoints:
        return scenario
    try:
        return scenario.with_setpoints(
            setpoint_of(seconds(stamp_ns - first_ns), values) for stamp_ns, values in taken
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


def seconds_since(stamps: NDArray[np.int64], zero_ns: int) -> Array:
    """Seconds (T,) after an instant."""
    return np.asarray(seconds(stamps - zero_ns), dtype=np.float64)


class Instants(NamedTuple):
    """Instants that are judged together."""

    stamps: NDArray[np.int64]  # (T,) [ns]
    times: Array  # (T,) [s] after the epoch of the leg
    positions: Array  # (3, N, T) [m], ENU, of the UAVs in the order of the scenario
    until_ns: int  # the next judged instant [ns], or the last of these


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
    left_out: tuple[str, ...] = ()  # what was damaged, in words
    window_s: float | None = None  # judge only so many seconds after its epoch
    sources: Mapping[int, str] = field(default_factory=dict)  # topic of the odometry by UAV

    @cached_property
    def forms(self) -> tuple[int, ...]:
        """Epochs [ns] of the formation legs; the stamp of the first message when none was recorded.

        One that gives way to the next within a control period is no leg: no UAV has flown it.
        """
        first_ns = first_formation_ns(self.epochs)
        if first_ns is None:
            return (min(track.first_ns for track in self.odometry.values()),)
        ends = [*(t0_ns for t0_ns, _ in self.epochs[1:]), NEVER_NS]
        legs = zip(self.epochs, ends, strict=True)
        shortest_ns = self.scenario.timing.dt_ns
        flown = [t0 for (t0, leg), end in legs if leg == FORMATION and end - t0 >= shortest_ns]
        return tuple(flown or [first_ns])

    @property
    def first_ns(self) -> int:
        """Epoch of the first formation leg that was announced, from which the leader's trajectory is counted."""
        first_ns = first_formation_ns(self.epochs)
        return self.forms[0] if first_ns is None else first_ns

    @property
    def start_ns(self) -> int:
        """Epoch of the leg, from which deadlines are counted."""
        return self.forms[self.leg]

    @cached_property
    def flown(self) -> Scenario:
        """The scenario with the slots that the UAVs took; VerdictError when they are open and not recorded."""
        if not self.scenario.formation.has_open_slots:
            return self.scenario
        if self.start_ns not in self.slots:
            raise VerdictError(
                "the recording does not say who takes which slot: expected the slots of the epoch at "
                f"{seconds(self.start_ns):.3f} s"
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
            later.append(self.start_ns + nanoseconds(self.window_s))
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

    def at(self, stamps: NDArray[np.int64], until_ns: int | None = None) -> Instants:
        """Times and positions at instants (T,) [ns], ascending; `until_ns`: the next one."""
        source = self.truth if self.judged_by == "truth" else self.odometry
        positions = vectors_at(source, self.scenario.uav_ids, stamps)
        until_ns = int(stamps[-1]) if until_ns is None else until_ns
        return Instants(stamps, seconds_since(stamps, self.start_ns), positions, until_ns)

    def blocks(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Instants]:
        """The instants between two times, both included, by default those of the leg; VerdictError when it has none."""
        if start_ns is None and self.samples < 2:
            raise VerdictError(
                "the recording holds no formation flight: expected odometry of the leader after "
                f"the epoch at {seconds(self.start_ns):.3f} s"
            )
        begin_ns = self.start_ns if start_ns is None else start_ns
        last_ns = self.end_ns if end_ns is None else end_ns
        first, end = self.clock.span(begin_ns, last_ns)
        for block in self.clock.blocks(first, end):
            first += block.size
            yield self.at(block.t_ns, int(self.clock.t_ns[first]) if first < end else None)


def whole(recording: Recording) -> Instants:
    """All judged instants at once, for short flights; errors as of `blocks`."""
    return recording.at(np.concatenate([block.stamps for block in recording.blocks()]))


def counter_rises(recording: Recording, start_ns: int, end_ns: int) -> dict[int, dict[str, float]]:
    """Rise of every counter, by its name, of every UAV between two instants; 0 where none is recorded."""
    rises = dict.fromkeys(recording.scenario.uav_ids, dict.fromkeys(COUNTERS, 0.0))
    for uavs, track in together(recording.counters):
        last = track.index(end_ns, "right")
        if last:
            first = track.index(start_ns, "left") if start_ns > track.first_ns else 0
            before = track.values[first - 1] if first else 0.0
            values = np.maximum(track.values[last - 1] - before, 0.0).tolist()
            for uav, of_uav in zip(uavs, values, strict=True):
                rises[uav] = dict(zip(COUNTERS, of_uav, strict=True))
    return rises


def require_all_uavs(recording: Recording) -> None:
    """Raise VerdictError when a UAV of the scenario is missing."""
    missing = [uav for uav in recording.scenario.uav_ids if uav not in recording.odometry]
    if missing:
        names = ", ".join(recording.sources.get(uav, f"/uav{uav}/odom") for uav in missing)
        raise VerdictError(f"no message on {names}: expected odometry of every UAV in the scenario")


def recording_of(flight: HeadlessFlight) -> Recording:
    """The input of a verdict from a headless flight, without a bag."""
    scenario, track, uavs = flight.scenario, flight.track, flight.scenario.uav_ids
    start_ns = int(flight.t_ns[0])
    dead = gone(scenario)  # a UAV whose process is dead sends nothing

    def all_of(values: Array, every: int = 1) -> Together:
        return Together(uavs, Track(flight.t_ns[::every], values))

    def sent(values: Array, every: int = 1) -> Mapping[int, Track]:
        """Tracks of values (T / every, N, ...) without those of silent ticks."""
        if not dead.any():
            return all_of(values, every)
        t_ns, there = flight.t_ns[::every], ~dead[::every].T
        return {
            uav: Track(t_ns[ticks], values[ticks, row])
            for row, (uav, ticks) in enumerate(zip(uavs, there, strict=True))
        }

    return Recording(
        scenario=scenario,
        odometry=all_of(track.odometry),
        wrench=sent(track.wrench),
        estimate=sent(track.estimate),
        truth=all_of(track.truth) if len(track.truth) else {},
        counters=sent(counters_of(track.diagnostics, scenario), status_every(scenario)),
        epochs=with_landing(scenario, ((start_ns, FORMATION),)),
        slots={start_ns: flight.slots} if flight.slots else {},
    )


def tolerance_of(recording: Recording, given: float | None) -> float:
    """Limit of the error at the deadline [m]: the given one, or that of the scenario."""
    return recording.scenario.formation.tolerance_m if given is None else given
