"""The verdict on the deadline of one UAV, by the figures of its error, with the causes of a miss.

A verdict is decided by its reasons, in `_reasons`: none is met, one whose cause voids it is void, else missed; a
keep-out that was entered is violated. Only what the UAVs could not help voids a deadline: see `Cause`. A UAV that was
not in place at the deadline because it gave way, and came in within the promise, is met late.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_sim.scenario.approach.deadline import shortest_from
from ptnsbc_sim.scenario.approach.path import EpochPlaces
from ptnsbc_sim.verdict.encounters import ancestors, gave_way
from ptnsbc_sim.verdict.error_figures import ChangeError, ErrorFigures
from ptnsbc_sim.verdict.recording import Absence, Recording, counter_rises, seconds_since
from ptnsbc_sim.verdict.track import Track, together

LONGEST_GAP_S = 0.25
"""Longest silence [s] that is only counted. A longer one makes the verdict void."""

LOST_S = 2.0
"""Longest silence [s] of the counters, which come 5 times a second, before the end of a leg."""


class Coverage(NamedTuple):
    """The record of a UAV in the judged time: how much of it there is, and what its counters say."""

    missing: int  # messages missing of those sent, or of one per control period
    longest_gap_s: float
    gap_at_s: float  # where the longest gap begins, after the epoch
    broken_from_s: float | None  # the first odometry or wrench that is not finite, after the epoch
    rises: Mapping[str, float]  # of its counters until the deadline


def coverages(recording: Recording) -> dict[int, Coverage]:
    """Coverage of the time from the epoch to the end of the leg; both ends count as messages.

    While a UAV does not belong to the formation it need not be heard.
    """
    covers: dict[int, Coverage] = {}
    due_ns = recording.start_ns + nanoseconds(recording.scenario.gains.formation.deadline_s)
    broken, rises = _broken_from_s(recording), counter_rises(recording, recording.start_ns, due_ns)
    for uavs, track in together(recording.odometry):
        away = {uav: recording.members.absences[uav] for uav in uavs}
        gaps = {spans: _longest_gap(recording, track, spans) for spans in set(away.values())}
        lost = missing(recording, uavs, track)
        for uav in uavs:
            covers[uav] = Coverage(lost[uav], *gaps[away[uav]], broken.get(uav), rises[uav])
    return covers


def _longest_gap(
    recording: Recording, track: Track, away: tuple[Absence, ...]
) -> tuple[float, float]:
    """The longest silence [s] in the judged time, but for absences, and where it begins after the epoch."""
    start_ns, end_ns = recording.start_ns, recording.end_ns
    stamps = track.t_ns[slice(*track.span(start_ns, end_ns))]
    edges = np.concatenate(([start_ns], stamps, [end_ns]))
    gaps = edges[1:] - edges[:-1]
    for absence in away:
        gaps[(edges[1:] > absence.begin_ns) & (edges[:-1] < absence.end_ns)] = 0
    longest = int(gaps.argmax())
    return float(seconds(gaps[longest])), float(seconds(edges[longest] - start_ns))


def missing(recording: Recording, uavs: Iterable[int], track: Track) -> dict[int, int]:
    """Messages of UAVs that were sent and are not in their `track`; real vehicles have rates of their own."""
    start_ns, end_ns = recording.start_ns, recording.end_ns
    # The total, not gap by gap: a late message and an early one after it are not a missing one.
    expected = round((end_ns - start_ns) / recording.scenario.timing.dt_ns) + 1
    begin, end = track.span(start_ns, end_ns)
    lost = dict.fromkeys(uavs, max(expected - max(end - begin, 0), 0))
    for uav in lost.keys() & recording.sent.keys():
        sent = recording.sent[uav]
        # From the last count before the epoch to the first count after the end: exact at both.
        first = max(sent.index(start_ns, "right") - 1, 0)
        last = min(sent.index(end_ns, "left"), sent.size - 1)
        begin, end = track.span(int(sent.t_ns[first]) + 1, int(sent.t_ns[last]))
        expected = round(float(sent.values[last, 0] - sent.values[first, 0]))
        lost[uav] = max(expected - max(end - begin, 0), 0)
    return lost


def incomplete(recording: Recording, uav: int, covers: Mapping[int, Coverage]) -> str:
    """The gaps of the recording of a UAV or of its leader, and an early end; empty when it is complete enough."""
    holes = []
    for name in dict.fromkeys((uav, recording.flown.leader.id)):
        gap = covers[name]
        if gap.longest_gap_s > LONGEST_GAP_S:
            span = f"nothing on /uav{name}/odom for {gap.longest_gap_s:.2f} s"
            holes.append(f"{span} from t = {gap.gap_at_s:.2f} s")
    timing, end_ns = recording.scenario.timing, recording.end_ns
    due_ns = recording.cut_off(recording.first_ns + timing.ticks * timing.dt_ns)
    # A flight of n periods ends with message n - 1.
    if seconds(due_ns - timing.dt_ns - end_ns) > LONGEST_GAP_S:
        first = min(recording.members.staying, key=lambda uav: recording.odometry[uav].last_ns)
        lengths = (f"{seconds(t_ns - recording.start_ns):.2f} s" for t_ns in (end_ns, due_ns))
        holes.append(f"/uav{first}/odom ends after {' of '.join(lengths)}")
    return ", ".join(holes)


def _broken_from_s(recording: Recording) -> dict[int, float]:
    """The time after the epoch of the first odometry or wrench that is not finite, of the UAVs that have such a one."""
    broken: dict[int, float] = {}
    start_ns, end_ns = recording.start_ns, recording.end_ns
    for uavs, track in chain(together(recording.odometry), together(recording.wrench)):
        for block in track.blocks(*track.span(start_ns, end_ns)):
            if np.isfinite(np.sum(block.values)):
                continue  # a sum of finite numbers may be infinite, one with NaN or inf is never finite
            finite = np.asarray(np.isfinite(block.values).all(axis=2))
            for row in np.flatnonzero(~finite.all(axis=0)).tolist():
                at_s = float(seconds(int(block.t_ns[finite[:, row].argmin()]) - start_ns))
                broken[uavs[row]] = min(broken.get(uavs[row], at_s), at_s)
    return broken


MET, MET_LATE, MISSED, VIOLATED, VOID = "met", "met late", "missed", "violated", "void"
WORST_FIRST = (VIOLATED, MISSED, VOID, MET_LATE, MET)
KEPT = (MET, MET_LATE)
"""The verdicts on who kept the promise: in place at the deadline, or so soon after giving way."""

TOLERANCE_M = 0.05
"""Default limit of the formation error at the deadline."""

MOST_EXCUSED = 0.5
"""Share of the time after the deadline that encounters may excuse at most."""

_HELD = "held for {s:.2f} s, link stale"
_NEAR = "near objects for {outside_s:.2f} s of the {after_s:.2f} s after the deadline"


class Cause(Enum):
    """Cause of a missed deadline: in words, and True where it voids the deadline."""

    # the recording does not show it
    LOST = "{membership}", True
    INCOMPLETE = "recording incomplete: {hole}", True
    ENDED = "recording ends after {end_s:.2f} s", True
    STATE_NOT_FINITE = "state not finite from t = {t_s:.2f} s"
    ERROR_NOT_FINITE = "error not finite from t = {t_s:.2f} s"
    # the error
    LEFT_AGAIN = "met at the deadline, but outside {band:.3f} m again until {until}"
    OUTSIDE = "outside {band:.3f} m until the end at {end_s:.2f} s"
    SETTLED_LATE = "settled after {t_s:.2f} s"
    TOO_LARGE = "error at the deadline above {tolerance:g} m"
    LATE_CHANGE = "{error:.3f} m off at {due_s:.2f} s, when {what} was due"
    NEAR_OBJECTS = f"outside {{band:.3f}} m {_NEAR}"
    # why an encounter does not excuse it
    TOO_SHORT = "the limits allow no deadline below {shortest:.2f} s, which no encounter excuses"
    NEVER_OVER = "an encounter lasts over the deadline until the end"
    NOT_BACK_WHEN_DUE = (
        "{error:.3f} m off at {due_s:.2f} s, when it had to be back after an encounter{promise}"
    )
    BACK_AND_AWAY = (
        "back at {due_s:.2f} s after an encounter, but outside {band:.3f} m again until {until}"
    )
    NOT_BACK = "not back after an encounter{promise}"
    # why it was late, and kept the promise all the same
    GAVE_WAY = "{error:.3f} m off at the deadline because {why}, in place at {t_s:.2f} s"
    CHANGE_GAVE_WAY = "{error:.3f} m off at {due_s:.2f} s, when {what} was due, in an encounter"
    # what happened before
    SILENT = "UAV {uav} silent from {t_s:.2f} s", True
    HELD = _HELD
    HELD_WITHOUT_LOSS = _HELD, True  # messages were late: the scenario neither loses nor delays any
    DEADLOCK = "in a deadlock for {s:.2f} s, avoidance left no way"
    SATURATED = "at a limit of speed, acceleration or thrust for {s:.2f} s"

    def __init__(self, words: str, voids: bool = False) -> None:
        self.words, self.voids = words, voids

    def because(self, **figures: Any) -> Reason:
        """The reason with its figures in words."""
        return Reason(self, self.words.format(**figures))


class Reason(NamedTuple):
    """One cause in one flight."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class UavVerdict:
    """The verdict on the deadline of one UAV. Errors in metres, times in seconds after the epoch."""

    uav: int
    slot: int  # its place in the formation, by the number of the UAV to which the scenario gives it
    verdict: str  # met | met late | missed | violated | void
    reason: str  # why not met, or why late; empty when met
    excuse: str  # the encounters that excuse the figures, empty when none does
    deadline_s: float
    due_s: float  # the deadline, or the end of the encounter that lasts over it
    start_error_m: float
    band_m: float  # tolerance of the settling time
    settling_s: float | None  # None: the error ends outside the band
    tolerance_m: float  # limit of the error at the deadline
    error_at_deadline_m: float | None  # None: the recording ends before the deadline
    # that error is within the tolerance, whatever excuses it; None: it came later, or had left, as planned
    in_place: bool | None
    # when it was within the tolerance, of a UAV that kept its promise and was late; else None
    arrived_s: float | None
    gave_way_to: tuple[str, ...]  # uavN or an obstacle; why it was not in place
    residual: float | None  # error at the deadline over the start error
    max_error_after_m: float | None  # after the deadline, outside encounters
    max_error_after_all_m: float | None  # after the deadline, inside encounters too
    rmse_after_m: float | None  # after the deadline, outside encounters
    encounter_s: float  # time inside encounters
    excused_outside_s: float  # of it: after the deadline and outside the band
    # longest time from the end of an encounter until back in the band; None: none
    regained_s: float | None
    recovery_s: float | None  # the promise for it
    saturated_s: float  # until the deadline
    holding_s: float  # until the deadline
    missing: int  # odometry messages missing of those sent, or of one per control period
    longest_gap_s: float  # between two odometry messages
    membership: str  # when it came and went, empty when it was there all the time
    lost: bool  # at the end; the others go on without it, so it does not count for the flight
    # those of the shape, or legs of a mission, that were due in this leg, after its deadline
    changes: tuple[ChangeError, ...]


def judge(figures: ErrorFigures, covers: Mapping[int, Coverage], intrusion: str = "") -> UavVerdict:
    """The verdict on one UAV, by its error over the whole leg; `intrusion`: the keep-outs that it entered, in words."""
    recording, uav = figures.recording, figures.uav
    reasons = _reasons(figures, covers)
    membership, causes = recording.members.text(uav), {reason.cause for reason in reasons}
    over, in_place = figures.over_deadline, figures.in_place
    way, due_ns = None, recording.start_ns + nanoseconds(figures.deadline_s)
    if in_place is False and over is not None:
        way = gave_way(recording, uav, over, due_ns)
    late = [] if reasons else _came_late(figures, membership if way is None else way.text(uav))
    if intrusion:
        verdict = VIOLATED
    elif any(cause.voids for cause in causes):
        verdict = VOID
    elif reasons:
        verdict = MISSED
    else:
        verdict = MET_LATE if late else MET
    not_finite = causes & {Cause.STATE_NOT_FINITE, Cause.ERROR_NOT_FINITE}
    regain, start, at = figures.longest_regain(), figures.start_error, figures.at_deadline
    return UavVerdict(
        uav=uav,
        slot=recording.slots.get(recording.start_ns, {}).get(uav, uav),
        verdict=verdict,
        reason=", ".join([*filter(None, [intrusion]), *(of.text for of in reasons or late)]),
        excuse="" if reasons else _excuse(figures, membership),
        deadline_s=figures.deadline_s,
        due_s=figures.due_s,
        start_error_m=start,
        band_m=figures.band,
        settling_s=None if not_finite else figures.settling_s,
        tolerance_m=figures.tolerance,
        error_at_deadline_m=at,
        in_place=in_place,
        arrived_s=figures.arrived_s if in_place is False and not reasons else None,
        gave_way_to=() if way is None else way.to,
        residual=at / start if at is not None and start > 0 else None,
        max_error_after_m=figures.max_after,
        max_error_after_all_m=figures.max_after_all,
        rmse_after_m=figures.rmse_after,
        encounter_s=figures.encounter_s,
        excused_outside_s=figures.excused_outside_s,
        regained_s=None if regain is None else regain.took_s,
        recovery_s=None if regain is None else regain.promised_s,
        saturated_s=covers[uav].rises["saturated_s"],
        holding_s=covers[uav].rises["holding_s"],
        missing=covers[uav].missing,
        longest_gap_s=covers[uav].longest_gap_s,
        membership=membership,
        lost=recording.members.lost(uav),
        changes=figures.at_changes,
    )


def _reasons(figures: ErrorFigures, covers: Mapping[int, Coverage]) -> list[Reason]:
    """Why the deadline was not met; empty when it was, whatever the UAV came near to."""
    recording, uav = figures.recording, figures.uav
    if (broken_s := covers[uav].broken_from_s) is not None:
        # Comparisons with NaN are false: the error would seem never to leave the band.
        return [Cause.STATE_NOT_FINITE.because(t_s=broken_s)]
    if figures.not_finite_s is not None:  # the leader's odometry is not
        return [Cause.ERROR_NOT_FINITE.because(t_s=figures.not_finite_s)]
    if recording.members.lost(uav):
        return [Cause.LOST.because(membership=recording.members.text(uav))]
    ended = figures.at_deadline is None
    miss = [] if ended else _miss(figures)
    if hole := incomplete(recording, uav, covers):
        return [Cause.INCOMPLETE.because(hole=hole), *miss]
    if ended:
        return [Cause.ENDED.because(end_s=figures.end_s)]
    return [*miss, *_before(figures)] if miss else []


def _miss(figures: ErrorFigures) -> list[Reason]:
    """By how much the deadline was missed, and why no encounter excuses that; empty when it was met."""
    late = _late(figures)
    for change in figures.at_changes if late is None else ():
        error = change.error_m
        if error is not None and not change.excused and error > figures.tolerance:
            late = Cause.LATE_CHANGE.because(error=error, due_s=change.due_s, what=change.what)
            break
    if late is not None:
        if figures.due_s > figures.deadline_s:
            inexcusable = _too_short(figures) or _unrecovered(figures)
            if inexcusable is not None:
                return [late, inexcusable]
        elif figures.left_again and (promise := _broken_promise(figures)):
            return [late, Cause.NOT_BACK.because(promise=promise)]
        else:
            return [late]
    after_s = figures.end_s - figures.deadline_s - figures.absent_s
    outside_s = figures.excused_outside_s
    if outside_s - figures.absent_s > MOST_EXCUSED * after_s:
        return [Cause.NEAR_OBJECTS.because(band=figures.band, outside_s=outside_s, after_s=after_s)]
    return []


def _came_late(figures: ErrorFigures, why: str) -> list[Reason]:
    """Why a UAV that kept its promise was not in place when something was due; empty when it was."""
    if figures.in_place is False:
        at, arrived_s = figures.at_deadline, figures.arrived_s
        return [Cause.GAVE_WAY.because(error=at, why=why, t_s=arrived_s)]
    recording = figures.recording
    return [
        Cause.CHANGE_GAVE_WAY.because(error=change.error_m, due_s=change.due_s, what=change.what)
        for change in figures.at_changes
        if change.error_m is not None
        and change.error_m > figures.tolerance
        and recording.members.expected(figures.uav, recording.first_ns + nanoseconds(change.due_s))
    ]


def _until(t_s: float | None) -> str:
    return "the end" if t_s is None else f"{t_s:.2f} s"


def _late(figures: ErrorFigures) -> Reason | None:
    """By how much the deadline was missed when nothing excuses it; None when it was met."""
    settled, at = figures.settling_s, figures.at_deadline
    if figures.left_again:
        return Cause.LEFT_AGAIN.because(band=figures.band, until=_until(settled))
    if settled is None:
        return Cause.OUTSIDE.because(band=figures.band, end_s=figures.end_s)
    if settled > figures.deadline_s:
        return Cause.SETTLED_LATE.because(t_s=settled)
    if at is None or at > figures.tolerance:
        return Cause.TOO_LARGE.because(tolerance=figures.tolerance)
    return None


def _too_short(figures: ErrorFigures) -> Reason | None:
    """The deadline that the limits of the vehicle allow from where it was at the epoch, when that is longer.

    A UAV that came later has its own deadline.
    """
    recording, uav = figures.recording, figures.uav
    flown, start_ns = recording.flown, recording.start_ns
    there = recording.members.at(start_ns)
    if not {uav, flown.leader.id} <= there:
        return None
    at = recording.at(np.array([start_ns]))
    begin_s = float(seconds_since(at.stamps, recording.first_ns)[0])
    places = {u: at.positions[:, k, 0] for k, u in enumerate(flown.uav_ids) if u in there}
    starts = EpochPlaces(places, {other: other for other in there}, begin_s)
    shortest = shortest_from(flown, starts, uav)
    if shortest is None or shortest <= figures.deadline_s:
        return None
    return Cause.TOO_SHORT.because(shortest=shortest)


def _unrecovered(figures: ErrorFigures) -> Reason | None:
    """Why an encounter over the deadline does not excuse the miss; None when it does."""
    at, regained, due_s = figures.at_due, figures.regained_s, figures.due_s
    if at is None:
        return Cause.NEVER_OVER.because()
    if at > figures.tolerance:
        promise = _broken_promise(figures)
        return Cause.NOT_BACK_WHEN_DUE.because(error=at, due_s=due_s, promise=promise)
    if regained is None or regained > due_s:
        return Cause.BACK_AND_AWAY.because(due_s=due_s, band=figures.band, until=_until(regained))
    return None


def _broken_promise(figures: ErrorFigures) -> str:
    """The first recovery time that was not enough, in words; empty when all were."""
    slack_s = 1.5 * seconds(figures.recording.scenario.timing.dt_ns)
    for regain in figures.regains:
        if regain.outside_s is not None and regain.took_s > regain.promised_s - slack_s:
            return f" that ended at {regain.over_s:.2f} s, in {regain.promised_s:.2f} s"
    return ""


def _before(figures: ErrorFigures) -> list[Reason]:
    """What happened before a missed deadline or a late exit."""
    recording, uav = figures.recording, figures.uav
    scenario, leader = recording.scenario, recording.flown.leader.id
    span = (0.0, figures.due_s)
    if figures.left_again:
        settled = figures.settling_s
        span = (figures.deadline_s, figures.end_s if settled is None else settled)
    needed = dict.fromkeys([*ancestors(recording.flown, uav), leader])
    if scenario.formation.reconfigures:
        needed = {uav: None}  # the others go on without the lost one
    reasons = []
    for other in needed:
        counters = recording.counters.get(other)
        if counters is not None and seconds(recording.end_ns - counters.last_ns) > LOST_S:
            t_s = seconds(counters.last_ns - recording.start_ns)
            reasons.append(Cause.SILENT.because(uav=other, t_s=t_s))
    excusable = scenario.lossy or scenario.formation.reconfigures
    begin_ns, end_ns = (recording.start_ns + nanoseconds(t_s) for t_s in span)
    rises = counter_rises(recording, begin_ns, end_ns)[uav]
    for name, cause in (
        ("holding_s", Cause.HELD if excusable else Cause.HELD_WITHOUT_LOSS),
        ("deadlock_s", Cause.DEADLOCK),
        ("saturated_s", Cause.SATURATED),
    ):
        if rises[name] > 0:
            reasons.append(cause.because(s=rises[name]))
    return reasons


def _excuse(figures: ErrorFigures, membership: str) -> str:
    """The encounters that excuse a met deadline, in words; empty when it needs no excuse."""
    late = _late(figures) is not None
    if not late and not figures.excused_outside_s:
        return membership
    due = f", the deadline counted at {figures.due_s:.2f} s" if late else ""
    if membership:
        return f"{membership}{due}"
    return f"outside {figures.band:.3f} m near objects for {figures.excused_outside_s:.2f} s{due}"
