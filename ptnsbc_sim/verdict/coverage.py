"""The completeness of a recording: missing messages, gaps, an early end, numbers that are not finite."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np

from ptnsbc_sim.verdict.members import Absence
from ptnsbc_sim.verdict.recording import NANO, Recording
from ptnsbc_sim.verdict.track import Series, Track

LONGEST_GAP_S = 0.25
"""Longest silence [s] that is only counted. A longer one makes the verdict void."""

LOST_S = 2.0
"""Longest silence [s] of the counters, which come 5 times a second, before the end of a leg."""


class Coverage(NamedTuple):
    """The share of the judged time that a track covers."""

    missing: int  # messages missing of those sent, or of one per control period
    longest_gap_s: float
    gap_at_s: float  # where the longest gap begins, after the epoch


def coverages(recording: Recording) -> dict[int, Coverage]:
    """Coverage of the odometry of every UAV; of those whose samples share their stamps it is worked out once."""
    found: dict[int, Coverage] = {}
    known: dict[tuple[int, tuple[Absence, ...]], Coverage] = {}
    for uav in recording.scenario.uav_ids:
        track = recording.odometry[uav]
        if uav in recording.sent or not isinstance(track, Series):
            found[uav] = coverage(recording, uav, track)
            continue
        alike = id(track.t_ns), recording.members.absences[uav]
        if alike not in known:
            known[alike] = coverage(recording, uav, track)
        found[uav] = known[alike]
    return found


def coverage(recording: Recording, uav: int, track: Track) -> Coverage:
    """Coverage of the time from the epoch to the end of the leg; both ends count as messages.

    While the UAV does not belong to the formation it need not be heard.

    Args:
        recording: the flight.
        uav: the UAV.
        track: stamped like the odometry of the UAV.
    """
    start_ns, end_ns = recording.start_ns, recording.end_ns
    longest_ns, at_ns, last_ns = -1, start_ns, start_ns
    stamps = (block.t_ns for block in track.blocks(*track.span(start_ns, end_ns)))
    for block in chain(stamps, [np.array([end_ns])]):
        edges = np.concatenate(([last_ns], block))
        gaps = np.diff(edges)
        for one in recording.members.absences[uav]:
            gaps[(edges[1:] > one.begin_ns) & (edges[:-1] < one.end_ns)] = 0
        longest = int(np.argmax(gaps))
        if gaps[longest] > longest_ns:
            longest_ns, at_ns = int(gaps[longest]), int(edges[longest])
        last_ns = int(edges[-1])
    lost = missing(recording, uav, track)
    return Coverage(lost, float(longest_ns) * NANO, float(at_ns - start_ns) * NANO)


def missing(recording: Recording, uav: int, track: Track) -> int:
    """Messages of a UAV that were sent and are not in `track`; real vehicles have rates of their own."""
    sent = recording.sent.get(uav)
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if sent is None:
        # The total, not gap by gap: a late message and an early one after it are not a missing one.
        expected = round((end_ns - start_ns) / recording.scenario.timing.dt_ns) + 1
        return max(expected - _count(track, start_ns, end_ns), 0)
    # From the last count before the epoch to the first count after the end: exact at both.
    first = max(sent.index(start_ns, "right") - 1, 0)
    last = min(sent.index(end_ns, "left"), sent.size - 1)
    before, after = sent.rows(first, first + 1), sent.rows(last, last + 1)
    expected = round(float(after.values[0, 0] - before.values[0, 0]))
    return max(expected - _count(track, before.last_ns + 1, after.last_ns), 0)


def _count(track: Track, first_ns: int, last_ns: int) -> int:
    first, end = track.span(first_ns, last_ns)
    return max(end - first, 0)


def _early_end(recording: Recording) -> str:
    """The odometry that ends before the flight does, empty when none does."""
    scenario, start_ns, end_ns = recording.scenario, recording.start_ns, recording.end_ns
    due_ns = recording.cut_off(recording.first_ns + scenario.timing.ticks * scenario.timing.dt_ns)
    last_ns = due_ns - scenario.timing.dt_ns  # a flight of n periods ends with message n - 1
    if (last_ns - end_ns) * NANO <= LONGEST_GAP_S:
        return ""
    first = min(recording.members.staying, key=lambda uav: recording.odometry[uav].last_ns)
    lengths = (f"{(t_ns - start_ns) * NANO:.2f} s" for t_ns in (end_ns, due_ns))
    return f"/uav{first}/odom ends after {' of '.join(lengths)}"


def incomplete(recording: Recording, uav: int, covers: Mapping[int, Coverage]) -> str:
    """The gaps of the recording of a UAV or of its leader; empty when it is complete enough.

    Args:
        recording: the leg.
        uav: the UAV.
        covers: coverage of the odometry of every UAV.
    """
    found = []
    for name in dict.fromkeys((uav, recording.flown.leader.id)):
        gap = covers[name]
        if gap.longest_gap_s > LONGEST_GAP_S:
            span = f"nothing on /uav{name}/odom for {gap.longest_gap_s:.2f} s"
            found.append(f"{span} from t = {gap.gap_at_s:.2f} s")
    found.append(_early_end(recording))
    return ", ".join(text for text in found if text)


def silent_from_s(recording: Recording, uav: int) -> float | None:
    """Time after the epoch from which a UAV's process published no counters; None when it did to the end."""
    counters = recording.counters.get(uav)
    if counters is None or (recording.end_ns - counters.last_ns) * NANO <= LOST_S:
        return None
    return float(counters.last_ns - recording.start_ns) * NANO


def first_bad_s(recording: Recording, track: Track | None) -> float | None:
    """Time after the epoch of the first sample that is not finite; None when all are finite."""
    if track is None:
        return None
    for block in track.blocks(*track.span(recording.start_ns, recording.end_ns)):
        if np.isfinite(np.sum(block.values)):
            continue  # a sum of finite numbers may be infinite, one with NaN or inf is never finite
        bad = np.flatnonzero(~np.isfinite(block.values).all(axis=1))
        if bad.size:
            return float(block.t_ns[bad[0]] - recording.start_ns) * NANO
    return None
