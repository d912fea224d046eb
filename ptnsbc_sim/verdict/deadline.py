"""The verdict on the deadline of one UAV, by the figures of its error, with the causes of a miss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ptnsbc_sim.scenario.approach.deadline import shortest_from
from ptnsbc_sim.scenario.approach.path import EpochPlaces
from ptnsbc_sim.verdict.coverage import Coverage, first_bad_s, incomplete, silent_from_s
from ptnsbc_sim.verdict.encounters import ancestors
from ptnsbc_sim.verdict.error_figures import ChangeError, ErrorFigures
from ptnsbc_sim.verdict.recording import NANO, Recording, counter_rise

MET, MISSED, VIOLATED, VOID = "met", "missed", "violated", "void"
WORST_FIRST = (VIOLATED, MISSED, VOID, MET)

TOLERANCE_M = 0.05
"""Default limit of the formation error at the deadline."""

MOST_EXCUSED = 0.5
"""Share of the time after the deadline that encounters may excuse at most."""


@dataclass(frozen=True)
class UavVerdict:
    """The verdict on the deadline of one UAV. Errors in metres, times in seconds after the epoch."""

    uav: int
    slot: int  # its place in the formation, by the number of the UAV to which the scenario gives it
    verdict: str  # met | missed | violated | void
    reason: str  # why not met, empty when met
    excuse: str  # what the figures owe to encounters, empty when nothing
    deadline_s: float
    due_s: float  # the deadline, or the end of the encounter that lasts over it
    start_error_m: float
    band_m: float  # tolerance of the settling time
    settling_s: float | None  # None: the error ends outside the band
    tolerance_m: float  # limit of the error at the deadline
    error_at_deadline_m: float | None  # None: the recording ends before the deadline
    residual: float | None  # error at the deadline over the start error
    max_error_after_m: float | None  # after the deadline, outside encounters
    max_error_after_all_m: float | None  # after the deadline, inside encounters too
    rmse_after_m: float | None  # after the deadline, outside encounters
    encounter_s: float  # time inside encounters
    excused_outside_s: float  # of it: after the deadline and outside the band
    regained_s: (
        float | None
    )  # longest time from the end of an encounter until back in the band; None: none
    recovery_s: float | None  # the promise for it
    saturated_s: float  # until the deadline
    holding_s: float  # until the deadline
    missing: int  # odometry messages missing of those sent, or of one per control period
    longest_gap_s: float  # between two odometry messages
    membership: str  # when it came and went, empty when it was there all the time
    lost: bool  # at the end; the others go on without it, so it does not count for the flight
    changes: tuple[
        ChangeError, ...
    ]  # those of the shape, or legs of a mission, that were due in this leg, after its deadline


def _rise(recording: Recording, uav: int, name: str, span_s: tuple[float, float]) -> float:
    """Rise of a counter between two times after the epoch."""
    counters = recording.counters.get(uav)
    if counters is None:
        return 0.0
    begin, end = (recording.start_ns + round(time / NANO) for time in span_s)
    return counter_rise(counters, name, begin, end)


def _left_again(found: UavVerdict) -> bool:
    """True if the error met the tolerance at the deadline and left the band after it."""
    at, settled = found.error_at_deadline_m, found.settling_s
    late = settled is None or settled > found.deadline_s
    return late and at is not None and at <= found.tolerance_m


def _late(found: UavVerdict, end_s: float) -> str:
    """By how much the deadline was missed when nothing excuses it, empty when it was met."""
    settled, band = found.settling_s, f"{found.band_m:.3f} m"
    if _left_again(found):
        until = "the end" if settled is None else f"{settled:.2f} s"
        return f"met at the deadline, but outside {band} again until {until}"
    if settled is None:
        return f"outside {band} until the end at {end_s:.2f} s"
    if settled > found.deadline_s:
        return f"settled after {settled:.2f} s"
    error = found.error_at_deadline_m
    if error is None or error > found.tolerance_m:
        return f"error at the deadline above {found.tolerance_m:g} m"
    return ""


def _unrecovered(found: UavVerdict, figures: ErrorFigures) -> str:
    """The reason why an encounter over the deadline does not excuse the miss, empty when it does."""
    at, regained, due = figures.at_due, figures.regained_s, f"{found.due_s:.2f} s"
    if at is None:
        return "an encounter lasts over the deadline until the end"
    if at > found.tolerance_m:
        return (
            f"{at:.3f} m off at {due}, when it had to be back after an encounter{_in_time(figures)}"
        )
    if regained is None or regained > found.due_s:
        until = "the end" if regained is None else f"{regained:.2f} s"
        return f"back at {due} after an encounter, but outside {found.band_m:.3f} m again until {until}"
    return ""


def _in_time(figures: ErrorFigures) -> str:
    """The recovery time that was not enough, in words."""
    one = figures.unregained()
    return "" if one is None else f" that ended at {one.over_s:.2f} s, in {one.promised_s:.2f} s"


def _late_change(found: UavVerdict) -> str:
    """The first change of the shape that came about too late, empty when none did."""
    for change in found.changes:
        error = change.error_m
        if error is not None and not change.excused and error > found.tolerance_m:
            return f"{error:.3f} m off at {change.due_s:.2f} s, when {change.what} was due"
    return ""


def _shortest_s(recording: Recording, uav: int) -> float | None:
    """Shortest deadline [s] from where a UAV was at the epoch; None for one that came later, by its own deadline."""
    there = {
        one
        for one in recording.scenario.uav_ids
        if not any(
            gap.begin_ns <= recording.start_ns < gap.end_ns for gap in recording.absences[one]
        )
    }
    flown = recording.flown
    if not {uav, flown.leader.id} <= there:
        return None
    at = recording.positions(np.array([recording.start_ns]))
    begin_s = float(recording.since_first(np.array([recording.start_ns]))[0])
    starts = EpochPlaces({one: at[one][0] for one in there}, {one: one for one in there}, begin_s)
    return shortest_from(flown, starts, uav)


def _too_short(recording: Recording, found: UavVerdict) -> str:
    """The deadline that the limits of the vehicle allow from where it was at the epoch, when that is longer."""
    shortest = _shortest_s(recording, found.uav)
    if shortest is None or shortest <= found.deadline_s:
        return ""
    return f"the limits allow no deadline below {shortest:.2f} s, which no encounter excuses"


def _miss(recording: Recording, found: UavVerdict, figures: ErrorFigures) -> str:
    """By how much the deadline was missed, empty when it was met."""
    miss = _late(found, figures.end_s) or _late_change(found)
    if miss and found.due_s > found.deadline_s:
        too_short = _too_short(recording, found)
        if too_short:
            return f"{miss}, {too_short}"
        unrecovered = _unrecovered(found, figures)
        miss = f"{miss}, {unrecovered}" if unrecovered else ""
    elif miss and _left_again(found) and _in_time(figures):
        miss = f"{miss}, not back after an encounter{_in_time(figures)}"
    after_s = figures.end_s - found.deadline_s - figures.absent_s
    if not miss and found.excused_outside_s - figures.absent_s > MOST_EXCUSED * after_s:
        return (
            f"outside {found.band_m:.3f} m near objects for {found.excused_outside_s:.2f} s of the "
            f"{after_s:.2f} s after the deadline"
        )
    return miss


def _excuse(found: UavVerdict) -> str:
    """The excuse of a met deadline by encounters; empty when it needs none."""
    if not found.excused_outside_s and not _late(found, np.inf):
        return found.membership
    due = f", the deadline counted at {found.due_s:.2f} s" if _late(found, np.inf) else ""
    if found.membership:
        return f"{found.membership}{due}"
    return f"outside {found.band_m:.3f} m near objects for {found.excused_outside_s:.2f} s{due}"


def _lost(recording: Recording, uav: int) -> list[str]:
    """The processes that a UAV depends on and that fell silent, in words."""
    needed = dict.fromkeys([*ancestors(recording.flown, uav), recording.flown.leader.id])
    if recording.scenario.formation.reconfigures:
        needed = {uav: None}  # the others go on without the lost one
    silent = ((one, silent_from_s(recording, one)) for one in needed)
    return [f"UAV {one} silent from {t_s:.2f} s" for one, t_s in silent if t_s is not None]


def _causes(recording: Recording, found: UavVerdict, end_s: float) -> tuple[list[str], bool]:
    """The events before a missed deadline or a late exit, and whether they void the verdict.

    Only what the UAVs could not help voids it: a lost process, and messages that were late although the
    scenario neither loses nor delays any.
    """
    span = (0.0, found.due_s)
    if _left_again(found):
        span = (found.deadline_s, end_s if found.settling_s is None else found.settling_s)
    lost = _lost(recording, found.uav)
    causes = list(lost)
    held = _rise(recording, found.uav, "holding_s", span)
    saturated = _rise(recording, found.uav, "saturated_s", span)
    if held > 0:
        causes.append(f"held for {held:.2f} s, link stale")
    blocked = _rise(recording, found.uav, "deadlock_s", span)
    if blocked > 0:
        causes.append(f"in a deadlock for {blocked:.2f} s, avoidance left no way")
    if saturated > 0:
        causes.append(f"at a limit of speed, acceleration or thrust for {saturated:.2f} s")
    late = (
        held > 0 and not recording.scenario.lossy and not recording.scenario.formation.reconfigures
    )
    return causes, bool(lost) or late


def _not_finite(recording: Recording, uav: int, figures: ErrorFigures) -> str:
    """The time from which a UAV's numbers are not finite; empty when all are finite.

    The error is not finite either when the leader's odometry is not.
    """
    own = [first_bad_s(recording, of.get(uav)) for of in (recording.odometry, recording.wrench)]
    times = [time for time in own if time is not None]
    if times:
        return f"state not finite from t = {min(times):.2f} s"
    bad_s = figures.not_finite_s
    return "" if bad_s is None else f"error not finite from t = {bad_s:.2f} s"


def judge(
    recording: Recording,
    uav: int,
    figures: ErrorFigures,
    tolerance: float,
    covers: Mapping[int, Coverage],
    intrusion: str = "",
) -> UavVerdict:
    """The verdict on one UAV.

    Args:
        recording: the leg.
        uav: the UAV.
        figures: its formation error over the whole leg.
        tolerance: limit of the error at the deadline [m].
        covers: coverage of the odometry of every UAV.
        intrusion: the keep-outs that it entered, in words; empty when it entered none.
    """
    found = _of_deadline(recording, uav, figures, tolerance, covers)
    if not intrusion:
        return found
    return replace(
        found, verdict=VIOLATED, reason=", ".join(filter(None, (intrusion, found.reason)))
    )


def _of_deadline(
    recording: Recording,
    uav: int,
    figures: ErrorFigures,
    tolerance: float,
    covers: Mapping[int, Coverage],
) -> UavVerdict:
    """The verdict on the deadline of one UAV, whatever it came near to."""
    found = _measured(recording, uav, figures, tolerance, covers[uav])
    not_finite = _not_finite(recording, uav, figures)
    if not_finite:
        # Comparisons with NaN are false: the error would seem never to leave the band.
        return replace(found, verdict=MISSED, reason=not_finite, settling_s=None)
    end_s = figures.end_s
    if found.lost:
        return replace(found, verdict=VOID, reason=found.membership)
    short = found.error_at_deadline_m is None
    miss = f"recording ends after {end_s:.2f} s" if short else _miss(recording, found, figures)
    hole = incomplete(recording, uav, covers)
    if hole:
        parts = [f"recording incomplete: {hole}", *([miss] if miss and not short else [])]
        return replace(found, verdict=VOID, reason=", ".join(parts))
    if short:
        return replace(found, verdict=VOID, reason=miss)
    if not miss:
        return replace(found, excuse=_excuse(found))
    causes, void = _causes(recording, found, end_s)
    return replace(found, verdict=VOID if void else MISSED, reason=", ".join([miss, *causes]))


def _measured(
    recording: Recording, uav: int, figures: ErrorFigures, tolerance: float, cover: Coverage
) -> UavVerdict:
    """All figures of one UAV."""
    regain, away = figures.longest_regain(), recording.absences[uav]
    deadline = recording.scenario.gains.formation.deadline_s
    start, at = figures.start_error, figures.at_deadline
    return UavVerdict(
        uav=uav,
        slot=recording.slot(uav),
        verdict=MET,
        reason="",
        excuse="",
        deadline_s=deadline,
        due_s=figures.due_s,
        start_error_m=start,
        band_m=figures.band,
        settling_s=figures.settling_s,
        tolerance_m=tolerance,
        error_at_deadline_m=at,
        residual=at / start if at is not None and start > 0 else None,
        max_error_after_m=figures.max_after,
        max_error_after_all_m=figures.max_after_all,
        rmse_after_m=figures.rmse_after,
        encounter_s=figures.encounter_s,
        excused_outside_s=figures.excused_outside_s,
        regained_s=None if regain is None else regain.took_s,
        recovery_s=None if regain is None else regain.promised_s,
        saturated_s=_rise(recording, uav, "saturated_s", (0.0, deadline)),
        holding_s=_rise(recording, uav, "holding_s", (0.0, deadline)),
        missing=cover.missing,
        longest_gap_s=cover.longest_gap_s,
        membership=", ".join(one.text(recording.first_ns) for one in away),
        lost=bool(away) and away[-1].for_good and not away[-1].planned,
        changes=figures.at_changes,
    )
