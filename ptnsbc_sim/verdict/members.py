"""The members of the formation over time in a recording: by the plan of the scenario, and by the messages.

A UAV was silent while its leader estimates are missing for longer than `communication.stale_s`: the rule of the UAVs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS
from ptnsbc_sim.scenario.slots import Formations, Membership, changed
from ptnsbc_sim.verdict.track import Track

_NANO = 1e-9


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
        begin, end = ((t_ns - first_ns) * _NANO for t_ns in (self.begin_ns, self.end_ns))
        if self.for_good:
            return f"{'left' if self.planned else 'lost'} at {begin:.2f} s"
        return (
            f"joined at {end:.2f} s"
            if self.planned
            else f"lost at {begin:.2f} s, back at {end:.2f} s"
        )


class Phase(NamedTuple):
    """A span in which the graph does not change; it lasts until the next one begins."""

    begin_ns: int
    scenario: Scenario
    absent: frozenset[int]
    moved: frozenset[int]  # UAVs with another parent, slot or lead than in the phase before


def absences(
    scenario: Scenario, tracks: Mapping[int, Track], first_ns: int
) -> dict[int, tuple[Absence, ...]]:
    """The absences of every UAV; none unless UAVs may come and go.

    Args:
        scenario: as flown.
        tracks: what each UAV sent at every tick; UAVs without a track count as there.
        first_ns: the first epoch [ns].
    """
    found: dict[int, tuple[Absence, ...]] = {uav: () for uav in scenario.uav_ids}
    if not scenario.formation.reconfigures:
        return found
    last_ns = max((track.last_ns for track in tracks.values() if track.size), default=first_ns)
    last_ns = min(
        last_ns, first_ns + scenario.timing.ticks * scenario.timing.dt_ns
    )  # processes go on until all have landed
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
    stale_ns, dt_ns = round(scenario.communication.stale_s / _NANO), scenario.timing.dt_ns
    spans, last = [], first_ns

    def silence(heard_ns: int, again_ns: int) -> Absence:
        return Absence(heard_ns + dt_ns, again_ns, False, heard_ns + dt_ns + stale_ns)

    for block in track.blocks():
        inside = (block.t_ns > last) & (block.t_ns <= last_ns)
        stamps = np.concatenate(([last], block.t_ns[inside]))
        for k in np.flatnonzero(np.diff(stamps) > stale_ns):
            spans.append(silence(int(stamps[k]), int(stamps[k + 1]) + dt_ns))
        last = max(int(stamps[-1]), last)
    if last_ns - last > stale_ns:
        spans.append(silence(last, NEVER_NS))
    return spans


class Members:
    """The members of the formation over a flight: nobody comes or goes unless the scenario says that UAVs may.

    Args:
        scenario: as flown.
        tracks: what each UAV sent at every tick; UAVs without a track count as there.
        first_ns: the first epoch [ns].
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
    cuts = np.searchsorted(stamps, [phase.begin_ns for phase in phases[1:]]).tolist()
    for phase, (first, end) in zip(phases, pairwise([0, *cuts, len(stamps)]), strict=True):
        if first < end:
            yield phase, slice(first, end)
