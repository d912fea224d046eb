"""The times in which a formation error does not count: a UAV, or an ancestor of it, avoids something.

An encounter of a UAV is a span in which its counter `avoidance_active_s` (/diagnostics, 5 Hz) rises, or
the counter of any of its ancestors in the tree. It begins at the last sample before the rise. It lasts
until the recovery time after the last rise, in which the UAV has to regain its place: the time base of the way back
for what it was off then, and one time constant of the formation loop. An encounter that begins after the deadline
excuses an exit from the tolerance band. An encounter that lasts over the deadline makes the deadline count at its end.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core import kernel
from ptnsbc_core.behaviours.recovery import recovery_duration
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.tasks.near_constraints import LATENCIES
from ptnsbc_core.timebase import plan_duration
from ptnsbc_core.types import Array
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.approach.deadline import turn_of
from ptnsbc_sim.scenario.approach.path import left_of_start
from ptnsbc_sim.scenario.constants import clearance_config, recovery_configs
from ptnsbc_sim.scenario.gains import gain_of
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS
from ptnsbc_sim.verdict.formation_error import formation_vectors
from ptnsbc_sim.verdict.recording import Recording, by_phase, seconds_since
from ptnsbc_sim.verdict.separation import distances
from ptnsbc_sim.verdict.track import Track, lengths, together

Window = tuple[int, int]  # [ns], inclusive

_ACTIVE = "avoidance_active_s"
_PAUSE_S = 1.0
_TIME_CONSTANTS = 3.0
_SLOWEST_RECOVERY_S = 10.0  # without kappa the loop would never recover
_GROWTH_NS = 100_000_000  # span over which the growth of an error is measured
_STEP_NS = 100_000_000  # between the instants at which the objects of an encounter are looked for
_SHARE = 0.25  # of the instants of the object that was nearest most often: who was near for less is not named
_UAV = re.compile(r"^uav(?=\d+$)")


class Encounter(NamedTuple):
    """A span in which the error does not count [ns], both ends inclusive."""

    begin_ns: int
    over_ns: int  # nothing keeps the UAV from its place any more
    back_ns: int  # the place has to be regained


def recovery_s(scenario: Scenario, error_m: float) -> float:
    """The time after an encounter within which a UAV that is `error_m` off its place must regain it [s].

    With `approach: task` there is no time base of the way back: three time constants and a second. Of unlike vehicles
    it is that of the slowest.
    """
    recovery = _recovery(_Alike(scenario))
    return max(recovery(uav, error_m) for uav in scenario.uav_ids)


class _Alike:
    """A scenario as the key of what is the same for all that differ in starts only, as the flights of a sweep do."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario

    def __hash__(self) -> int:
        return id(self.scenario.topology)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Alike) and self.scenario.shares_all_but_starts(other.scenario)


@lru_cache(maxsize=4)
def _recovery(alike: _Alike) -> Callable[[int, float], float]:
    """`recovery_s` of a UAV by its id."""
    scenario = alike.scenario
    loop = gain_of(scenario.gains, scenario.gains.formation)  # as flown
    rate = loop.scale * loop.kappa
    settling = 1.0 / rate if rate > 0 else np.inf
    if scenario.formation.approach != "planned":
        constant = _PAUSE_S + min(_TIME_CONSTANTS * settling, _SLOWEST_RECOVERY_S)
        return lambda *_: constant
    configs, rest_s = recovery_configs(scenario), min(settling, _SLOWEST_RECOVERY_S)
    duration_s = kernel.prepared(recovery_duration, 0.0, configs[scenario.leader.id])
    return lambda uav, error_m: duration_s(error_m, configs[uav]) + rest_s


def rising(counters: Mapping[int, Track], name: str) -> dict[int, list[Window]]:
    """Spans in which a counter of each UAV rises, one of `COUNTERS`."""
    spans: dict[int, list[Window]] = {uav: [] for uav in counters}
    for uavs, track in together(counters):
        active = track.values[..., COUNTERS.index(name)]
        rows, ticks = np.nonzero((active[1:] > active[:-1]).T)
        for row, tick in zip(rows.tolist(), ticks.tolist(), strict=True):
            spans[uavs[row]].append((int(track.t_ns[tick]), int(track.t_ns[tick + 1])))
    return {uav: merged(windows) for uav, windows in spans.items()}


def merged(windows: Iterable[Window]) -> list[Window]:
    """Windows without overlap: those that overlap become one."""
    result: list[Window] = []
    for begin, end in sorted(windows):
        if result and begin <= result[-1][1]:
            result[-1] = (result[-1][0], max(end, result[-1][1]))
        else:
            result.append((begin, end))
    return result


def ancestors(scenario: Scenario, uav_id: int) -> list[int]:
    """The UAV itself, its parents, and so on up to the leader."""
    found = [uav_id]
    for one in found:
        found += [
            parent for parent in scenario.communication.parents_of(one) if parent not in found
        ]
    return found


def encounters(recording: Recording) -> dict[int, list[Encounter]]:
    """Encounters of every UAV, recovery included."""
    scenario, absences = recording.flown, recording.members.absences
    own = rising(recording.counters, _ACTIVE)
    away = {
        uav: [(span.begin_ns, min(span.end_ns, recording.end_ns)) for span in spans]
        for uav, spans in absences.items()
    }
    for window, concerned in _changes(recording):
        for uav in concerned:
            own.setdefault(uav, []).append(window)
    windows = [window for of_uav in (*own.values(), *away.values()) for window in of_uav]
    ends = sorted({end for _, end in windows})
    if not ends:
        return {uav: [] for uav in scenario.uav_ids}
    recovery = _recovery(_Alike(scenario))
    back_ns = {  # of every UAV, by the end of the encounter
        uav: {
            t: t + nanoseconds(recovery(uav, error_m)) for t, error_m in zip(ends, off, strict=True)
        }
        for uav, off in zip(scenario.uav_ids, _to_regain(recording, ends).tolist(), strict=True)
    }
    cuts_ns = [0, *(phase.begin_ns for phase in recording.phases[1:]), NEVER_NS]

    result = {}
    for uav in scenario.uav_ids:
        spans = []
        for phase, (from_ns, until_ns) in zip(recording.phases, pairwise(cuts_ns), strict=True):
            line = ancestors(phase.scenario, uav)
            for hops, ancestor in enumerate(line):
                for begin, end in own.get(ancestor, ()):
                    if end >= from_ns and begin < until_ns:  # the slowest of them is back last
                        slowest_ns = max([back_ns[other][end] for other in line[: hops + 1]])
                        spans.append(Encounter(begin, end, slowest_ns))
        # A UAV that comes has its own deadline, and disturbs nobody.
        spans += [Encounter(a, b, back_ns[uav][b]) for a, b in away[uav]]
        result[uav] = _joined(spans)
    return result


def _changes(recording: Recording) -> Iterator[tuple[Window, Iterable[int]]]:
    """The silences after which UAVs have other places in the graph, and these UAVs.

    Without its leader that is everybody: until the loss is noticed, errors are measured from a vehicle that nobody
    leads, also those of UAVs that leave meanwhile.
    """
    stale_ns = nanoseconds(recording.scenario.communication.stale_s)
    for phase in recording.phases[1:]:
        if phase.moved:
            begin_ns = phase.begin_ns - stale_ns - recording.scenario.timing.dt_ns
            yield (begin_ns, phase.begin_ns), phase.moved
    for uav, spans in recording.members.absences.items():
        for span in spans:
            ((phase, _),) = by_phase(recording.phases, np.array([span.begin_ns]))
            if not span.planned and phase.scenario.leader.id == uav:
                yield (span.begin_ns, span.noticed_ns), recording.scenario.uav_ids


def _to_regain(recording: Recording, ends: Sequence[int]) -> Array:
    """The distances that N UAVs have to regain (N, E) [m] at the ends of E encounters [ns], 0 where unknown.

    It is the deviation from the plan, and what the velocity at which it grows adds until the loop has stopped it. Until
    the deadline the plan of a follower is its start error times 1 - h; the leader has no plan to return to before.
    """
    scenario, start_ns = recording.flown, recording.start_ns
    gain = gain_of(scenario.gains, scenario.gains.formation)  # as flown
    slowing_s, duration_s = 1.0 / max(gain.scale * gain.kappa, 1e-9), plan_duration(gain)
    looked = (start_ns, *ends, *(end + _GROWTH_NS for end in ends))
    looked_ns = [min(max(t_ns, start_ns), recording.end_ns) for t_ns in looked]
    stamps = np.array(sorted(set(looked_ns)), dtype=np.int64)
    begin, *rows = stamps.searchsorted(looked_ns).tolist()
    now, soon = rows[: len(ends)], rows[len(ends) :]
    block = recording.at(stamps)
    vectors = formation_vectors(recording, block)
    left = left_of_start(turn_of(scenario), block.times / duration_s, vectors[:, :, begin, None])
    lead = scenario.uav_ids.index(scenario.leader.id)
    left[:, lead] = 0.0
    vectors -= left
    vectors[:, lead, block.times < gain.duration_s] = 0.0
    beside = lengths(vectors)
    growing = np.maximum(beside[:, soon] - beside[:, now], 0.0) / seconds(_GROWTH_NS)
    off = beside[:, now] + growing * slowing_s
    return np.where(np.isfinite(off), off, 0.0)


class GaveWay(NamedTuple):
    """The UAV that gave way in an encounter, and to whom or what."""

    uav: int
    to: tuple[str, ...]  # uavN, or the name of an obstacle

    def text(self, uav: int) -> str:
        """In words, of an encounter of `uav`."""
        who = "it" if self.uav == uav else f"UAV {self.uav}, which it follows,"
        return f"{who} gave way to {listed(self.to)}"


def listed(names: Iterable[str]) -> str:
    """UAVs, as uavN, and obstacles in words."""
    *most, last = (_UAV.sub("UAV ", name) for name in names)
    return f"{', '.join(most)} and {last}" if most else last


def gave_way(recording: Recording, uav: int, encounter: Encounter, due_ns: int) -> GaveWay | None:
    """The one that gave way the longest before something was due: a UAV, or one that it follows.

    None: others came or went.

    What was over so early that the way back was long enough does not count.

    The messages do not name an object. At each instant it is the one with the least speed left: of the closing speed
    that can still be braked before its keep-out, what is not flown yet.
    """
    _, over_ns, back_ns = encounter
    begin_ns = max(encounter.begin_ns, due_ns - (back_ns - over_ns))
    scenario = [of for of in recording.phases if of.begin_ns <= over_ns][-1].scenario
    active = rising(recording.counters, _ACTIVE)
    windows = {
        one: [(a, b) for a, b in active[one] if a < over_ns and b > begin_ns]
        for one in ancestors(scenario, uav)
        if one in active
    }
    who = max(windows, key=lambda one: sum(b - a for a, b in windows[one]), default=uav)
    if not windows.get(who):
        return None
    clearance = clearance_config(scenario, who)
    braking = clearance.deceleration
    lost = braking * LATENCIES * clearance.lag_s
    name, names = f"uav{who}", list[str]()
    for begin, end in windows[who]:
        at = recording.at(np.arange(max(begin, begin_ns), min(end, over_ns) + 1, _STEP_NS))
        times = seconds_since(at.stamps, recording.first_ns)
        others, left = [], []
        for first, seen, keep_outs, apart in distances(scenario, at.positions, times):
            for second, keep_out_m, distance in zip(seen, keep_outs, apart, strict=True):
                if name in (first, second):
                    others.append(second if first == name else first)
                    gap_m = np.maximum(distance - keep_out_m, 0.0)
                    closing = -np.gradient(distance, times) if times.size > 1 else 0.0
                    left.append(np.sqrt(lost**2 + 2.0 * braking * gap_m) - lost - closing)
        names += [others[k] for k in np.argmin(left, axis=0)]
    counts = Counter(names).most_common()
    return GaveWay(who, tuple(name for name, count in counts if count >= _SHARE * counts[0][1]))


def _joined(spans: Iterable[Encounter]) -> list[Encounter]:
    """Encounters without overlap: those that overlap become one, whose way back is the last one."""
    result: list[Encounter] = []
    for one in sorted(spans):
        if result and one.begin_ns <= result[-1].back_ns:
            last = max(result[-1], one, key=lambda span: span.back_ns)
            result[-1] = last._replace(begin_ns=result[-1].begin_ns)
        else:
            result.append(one)
    return result


def inside(windows: Sequence[Sequence[Encounter]], t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The instants (T,), ascending, that lie in any of the encounters of each of N UAVs, as a mask (N, T)."""
    mask = np.zeros((len(windows), t_ns.size), dtype=np.bool_)
    spans = [(row, window) for row, of_uav in enumerate(windows) for window in of_uav]
    begins = t_ns.searchsorted([window.begin_ns for _, window in spans]).tolist()
    ends = t_ns.searchsorted([window.back_ns for _, window in spans], "right").tolist()
    for (row, _), begin, end in zip(spans, begins, ends, strict=True):
        mask[row, begin:end] = True
    return mask
