"""Was the deadline met: settling, error at the deadline, and what voids the question."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.build import trajectory_vector
from ptnsbc_tools.verdict.coverage import coverage, incomplete, not_finite
from ptnsbc_tools.verdict.recording import NANO, Recording, gained
from ptnsbc_tools.verdict.running import ErrorFigures

MET, MISSED, VOID = "met", "missed", "void"


@dataclass(frozen=True)
class UavVerdict:
    """How one UAV kept its promise. Errors in metres, times in seconds after the epoch."""

    uav: int
    verdict: str  # met | missed | void
    reason: str  # why not met, empty when met
    deadline_s: float
    start_error_m: float
    band_m: float  # tolerance of the settling time
    settling_s: float | None  # None: never within the band for good
    tolerance_m: float  # hard limit at the deadline
    error_at_deadline_m: float | None  # None: the recording ends before it
    residual: float | None  # error at the deadline over the start error
    max_error_after_m: float | None  # after the deadline, outside encounters
    rmse_after_m: float | None  # after the deadline, outside encounters
    encounter_s: float  # time in encounter windows
    saturated_s: float  # until the deadline
    holding_s: float  # until the deadline
    missing: int  # odometry messages, of those sent or of one per control period
    longest_gap_s: float  # between two of them


def formation_errors(
    recording: Recording, grid: NDArray[np.int64], positions: dict[int, Array]
) -> dict[int, Array]:
    """Formation error (T,) [m]: |(p_i - p_1) - o_i|, for the leader |p_1 - p_r(t)|."""
    scenario = recording.scenario
    leader = positions[scenario.leader_id]
    vector = trajectory_vector(scenario)
    times = (grid - recording.first_ns) * NANO  # a new leg does not begin the trajectory anew
    path = np.stack([reference(vector, float(t)).position for t in times])
    errors = {}
    for uav in scenario.uav_ids:
        goal = path if uav == scenario.leader_id else leader + scenario.offset(uav)
        errors[uav] = np.linalg.norm(positions[uav] - goal, axis=1)
    return errors


def _gained(recording: Recording, uav: int, name: str, span_s: tuple[float, float]) -> float:
    """What a counter gained between two times after the epoch."""
    counters = recording.counters.get(uav)
    if counters is None:
        return 0.0
    begin, end = (recording.start_ns + round(time / NANO) for time in span_s)
    return gained(counters, name, begin, end)


def _left_again(found: UavVerdict) -> bool:
    """Whether the deadline itself was met, and the band left after it."""
    at, settled = found.error_at_deadline_m, found.settling_s
    late = settled is None or settled > found.deadline_s
    return late and at is not None and at <= found.tolerance_m


def _miss(found: UavVerdict, end_s: float) -> str:
    """How far off the deadline was, empty when it was met."""
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


def _causes(recording: Recording, found: UavVerdict, end_s: float, avoiding: bool) -> list[str]:
    """What voids a deadline that was not met: what happened before it, or before the late exit."""
    span = (0.0, found.deadline_s)
    if _left_again(found):
        span = (found.deadline_s, end_s if found.settling_s is None else found.settling_s)
    causes = ["avoidance active at the deadline"] if avoiding else []
    held = _gained(recording, found.uav, "holding_s", span)
    saturated = _gained(recording, found.uav, "saturated_s", span)
    if held > 0:
        causes.append(f"held for {held:.2f} s, link stale")
    if saturated > 0:
        causes.append(f"saturated for {saturated:.2f} s")
    return causes


def judge(recording: Recording, uav: int, figures: ErrorFigures, tolerance: float) -> UavVerdict:
    """The verdict on one UAV from the figures of its formation error over the whole leg."""
    found = _measured(recording, uav, figures, tolerance)
    nonsense = not_finite(recording, uav, figures.not_finite_s)
    if nonsense:
        # Comparisons with NaN are false: it would pass for an error that never left the band.
        return replace(found, verdict=MISSED, reason=nonsense, settling_s=None)
    end_s = figures.end_s
    short = found.error_at_deadline_m is None
    miss = f"recording ends after {end_s:.2f} s" if short else _miss(found, end_s)
    hole = incomplete(recording, uav)
    if hole:
        parts = [f"recording incomplete: {hole}", *([miss] if miss and not short else [])]
        return replace(found, verdict=VOID, reason=", ".join(parts))
    if short:
        return replace(found, verdict=VOID, reason=miss)
    if not miss:
        return found
    causes = _causes(recording, found, end_s, bool(figures.avoiding))
    verdict = VOID if causes else MISSED
    return replace(found, verdict=verdict, reason=", ".join([miss, *causes]))


def _measured(
    recording: Recording, uav: int, figures: ErrorFigures, tolerance: float
) -> UavVerdict:
    """All figures of one UAV."""
    deadline = recording.scenario.gains.formation.deadline_s
    start, at = figures.start_error, figures.at_deadline
    cover = coverage(recording, uav, recording.odometry[uav])
    return UavVerdict(
        uav=uav,
        verdict=MET,
        reason="",
        deadline_s=deadline,
        start_error_m=start,
        band_m=figures.band,
        settling_s=figures.settling_s,
        tolerance_m=tolerance,
        error_at_deadline_m=at,
        residual=at / start if at is not None and start > 0 else None,
        max_error_after_m=figures.max_after,
        rmse_after_m=figures.rmse_after,
        encounter_s=figures.encounter_s,
        saturated_s=_gained(recording, uav, "saturated_s", (0.0, deadline)),
        holding_s=_gained(recording, uav, "holding_s", (0.0, deadline)),
        missing=cover.missing,
        longest_gap_s=cover.longest_gap_s,
    )
