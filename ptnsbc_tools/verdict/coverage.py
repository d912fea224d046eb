"""Is the recording whole, and made of numbers: messages missing, gaps, an early end, NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_tools.verdict.recording import NANO, Recording, Series

LONGEST_GAP_S = 0.25
"""Longest silence [s] that is only counted: nobody knows what a UAV did in a longer one."""


@dataclass(frozen=True)
class Coverage:
    """How much of the judged time a series covers."""

    missing: int  # messages short of as many as were sent, or of one per control period
    longest_gap_s: float
    gap_at_s: float  # after the epoch, where the longest gap begins


def coverage(recording: Recording, uav: int, series: Series) -> Coverage:
    """From the epoch to the end of the judged time, both of which end a gap as a message does.

    Args:
        recording: the flight.
        uav: whose series it is.
        series: stamped like its odometry.
    """
    start_ns, end_ns = recording.start_ns, recording.end_ns
    stamps = _within(series, start_ns, end_ns)
    edges = np.concatenate(([start_ns], stamps, [end_ns]))
    gaps = np.diff(edges)
    longest = int(np.argmax(gaps))
    return Coverage(
        missing=_missing(recording, recording.sent.get(uav), series),
        longest_gap_s=float(gaps[longest]) * NANO,
        gap_at_s=float(edges[longest] - start_ns) * NANO,
    )


def _within(series: Series, start_ns: int, end_ns: int) -> NDArray[np.int64]:
    return series.t_ns[(series.t_ns >= start_ns) & (series.t_ns <= end_ns)]


def _missing(recording: Recording, sent: Series | None, series: Series) -> int:
    """Messages that should be there and are not; real vehicles have rates of their own."""
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if sent is None:
        # In all, not gap by gap: a late message and the early one after it are none too few.
        expected = round((end_ns - start_ns) / recording.scenario.dt_ns) + 1
        return max(expected - _within(series, start_ns, end_ns).size, 0)
    # From the last count before the epoch to the first one after the end: exact at both.
    first = max(int(np.searchsorted(sent.t_ns, start_ns, side="right")) - 1, 0)
    last = min(int(np.searchsorted(sent.t_ns, end_ns)), sent.t_ns.size - 1)
    expected = round(float(sent.values[last, 0] - sent.values[first, 0]))
    found = _within(series, int(sent.t_ns[first]) + 1, int(sent.t_ns[last]))
    return max(expected - found.size, 0)


def _early_end(recording: Recording) -> str:
    """The odometry that ends before the flight does, empty when none does."""
    scenario, start_ns, end_ns = recording.scenario, recording.start_ns, recording.end_ns
    due_ns = recording.due_ns
    last_ns = due_ns - scenario.dt_ns  # a flight of n periods ends with message n - 1
    if (last_ns - end_ns) * NANO <= LONGEST_GAP_S:
        return ""
    first = min(scenario.uav_ids, key=lambda uav: int(recording.odometry[uav].t_ns[-1]))
    lengths = (f"{(t_ns - start_ns) * NANO:.2f} s" for t_ns in (end_ns, due_ns))
    return f"/uav{first}/odom ends after {' of '.join(lengths)}"


def incomplete(recording: Recording, uav: int) -> str:
    """What is missing of a UAV or of the leader it is measured against; empty: enough is there."""
    found = []
    for name in dict.fromkeys((uav, recording.scenario.leader_id)):
        gap = coverage(recording, name, recording.odometry[name])
        if gap.longest_gap_s > LONGEST_GAP_S:
            span = f"nothing on /uav{name}/odom for {gap.longest_gap_s:.2f} s"
            found.append(f"{span} from t = {gap.gap_at_s:.2f} s")
    found.append(_early_end(recording))
    return ", ".join(text for text in found if text)


def _first_bad_s(recording: Recording, series: Series | None) -> float | None:
    if series is None:
        return None
    judged = (series.t_ns >= recording.start_ns) & (series.t_ns <= recording.end_ns)
    bad = series.t_ns[judged & ~np.isfinite(series.values).all(axis=1)]
    return float(bad[0] - recording.start_ns) * NANO if bad.size else None


def not_finite(recording: Recording, uav: int, times: Array, error: Array) -> str:
    """Since when a UAV's numbers are none; empty when all are finite.

    Args:
        recording: the flight.
        uav: whose odometry and wrench.
        times: (T,) [s] of the error.
        error: (T,) [m]; it is none either when the leader's odometry is not.
    """
    own = [_first_bad_s(recording, of.get(uav)) for of in (recording.odometry, recording.wrench)]
    since = [time for time in own if time is not None]
    if since:
        return f"state not finite from t = {min(since):.2f} s"
    bad = np.flatnonzero(~np.isfinite(error))
    return f"error not finite from t = {times[bad[0]]:.2f} s" if bad.size else ""
