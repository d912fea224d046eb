"""The verdict on the legs of a mission, each when it was due."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ptnsbc_sim.scenario.mission.legs import (
    FIRST,
    LandLeg,
    ScheduledLeg,
    is_cut_short,
)
from ptnsbc_sim.verdict.deadline import MET, MISSED, VIOLATED, VOID, UavVerdict
from ptnsbc_sim.verdict.recording import NANO, Recording
from ptnsbc_sim.verdict.separation import Separation

CUT_SHORT = "cut short"
"""The verdict on a leg that gave way to another one before it was due: it is not judged."""

_EXACT_S = 1e-9


@dataclass(frozen=True)
class MissionLegVerdict:
    """The verdict on one leg of the mission. Times in seconds after the first epoch, the error in metres."""

    number: int  # from 1; 0 for the one that a cancelled leg gave way to
    name: str
    kind: str
    begin_s: float
    due_s: float
    error_m: (
        float | None
    )  # the largest one when it was due; of a landing the largest height above the ground
    uav: int | None  # that had it
    verdict: str  # met | missed | violated | void | cut short
    reason: str  # why not met, empty when met


class _Error(NamedTuple):
    uav: int
    error_m: float | None
    excused: bool


def mission_legs(
    recording: Recording,
    judged: Sequence[Sequence[UavVerdict]],
    separations: Iterable[Separation],
    tolerance: float,
) -> tuple[MissionLegVerdict, ...]:
    """The verdicts on the legs that are due before the flight ends, or were cut short.

    Args:
        recording: the whole flight.
        judged: the verdicts on the UAVs, by epoch.
        separations: the closest approaches, also of spans that overlap.
        tolerance: limit of an error [m].
    """
    scenario = recording.scenario
    if not scenario.legs:
        return ()
    entered = [pair for pair in separations if pair.entered]
    end_s = (
        (scenario.timing.ticks - 1) * scenario.timing.dt_ns * NANO
    )  # the last instant of the flight
    end_s = end_s if recording.window_s is None else min(end_s, recording.window_s)
    last_s = (recording.last_ns - recording.first_ns) * NANO
    until_s = [*(leg.begin_s for leg in scenario.legs[1:]), np.inf]
    found = []
    for one, next_s in zip(scenario.legs, until_s, strict=True):
        if one.due_s > end_s + _EXACT_S and not is_cut_short(scenario.legs, one):
            continue
        near = [pair for pair in entered if one.begin_s <= pair.at_s < next_s]
        found.append(_judged(one, _errors(recording, one, judged), near, tolerance, last_s))
    return tuple(found)


def _errors(
    recording: Recording, one: ScheduledLeg, judged: Sequence[Sequence[UavVerdict]]
) -> list[_Error] | None:
    """The errors of all UAVs when a leg was due; None: a later leg took its place before."""
    if one.number == FIRST:
        return [
            _Error(uav.uav, uav.error_at_deadline_m, uav.due_s > uav.deadline_s)
            for uav in judged[0]
        ]
    if isinstance(one.leg, LandLeg):
        return _heights(recording, one)
    if is_cut_short(recording.scenario.legs, one):
        return None
    return [
        _Error(uav.uav, due.error_m, due.excused)
        for leg in judged
        for uav in leg
        for due in uav.changes
        if due.number == one.number and due.due_s == one.due_s
    ]


def _heights(recording: Recording, one: ScheduledLeg) -> list[_Error]:
    """Heights above the ground when the landing was due."""
    due_ns = recording.first_ns + round(one.due_s / NANO)
    if due_ns > recording.last_ns:
        return []
    at = recording.positions(np.array([due_ns]))
    return [
        _Error(uav, max(float(place[0, 2]) - one.leg.ground_m, 0.0), False)
        for uav, place in at.items()
    ]


def _judged(
    one: ScheduledLeg,
    errors: list[_Error] | None,
    entered: list[Separation],
    tolerance: float,
    last_s: float,
) -> MissionLegVerdict:
    known = [error for error in errors or () if error.error_m is not None]
    worst = max(known, key=lambda error: error.error_m or 0.0, default=None)
    late = [error for error in known if not error.excused and not _within(error, tolerance)]
    verdict, reason = MET, ""
    if entered:
        pair = min(entered, key=lambda one: one.distance_m - one.keep_out_m)
        verdict = VIOLATED
        reason = f"{pair.first} {pair.distance_m:.3f} m from {pair.second} at {pair.at_s:.2f} s"
    elif late:
        verdict = MISSED
        named = ", ".join(f"UAV {error.uav} {error.error_m:.3f} m" for error in late)
        off = "above the ground" if isinstance(one.leg, LandLeg) else "off"
        reason = f"{named} {off} at {one.due_s:.2f} s, expected at most {tolerance:g} m"
    elif errors is None:
        verdict, reason = CUT_SHORT, "by an operator"
    elif not known:
        verdict = VOID
        reason = f"the recording ends after {last_s:.2f} s, it was due at {one.due_s:.2f} s"
    return MissionLegVerdict(
        one.number,
        one.name,
        one.leg.kind,
        one.begin_s,
        one.due_s,
        None if worst is None else worst.error_m,
        None if worst is None else worst.uav,
        verdict,
        reason,
    )


def _within(error: _Error, tolerance: float) -> bool:
    """Also whether it is a number: a comparison with NaN is false."""
    return error.error_m is not None and error.error_m <= tolerance
