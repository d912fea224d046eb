"""Figures of the formation error of one UAV: settling, and the errors when something was due."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.mission.legs import FIRST, LandLeg, is_cut_short
from ptnsbc_sim.verdict.encounters import Encounter, inside
from ptnsbc_sim.verdict.recording import Instants, Recording
from ptnsbc_sim.verdict.track import ValueAt, max_of

SHARE_OF_START = 0.02
"""Share of the start error that widens the band of the settling time."""

_EXACT_S = 1e-9


@dataclass(frozen=True)
class ChangeError:
    """The error of one UAV when a change of the shape, or a leg of a mission, was due.

    Times in seconds after the first epoch.
    """

    number: int  # of the change or of the leg, from 1
    what: str  # in words
    due_s: float  # the end of it
    error_m: float | None  # None: the leg ends before it
    excused: bool  # an encounter lasts over it


@dataclass
class Regain:
    """The return of a UAV to its place after one encounter. Times in seconds after the epoch."""

    over_s: float  # when nothing kept it from its place any more
    promised_s: float  # recovery time: so long after it the UAV has to be back
    # the last time outside the band, until the recovery time is over
    outside_s: float | None = None

    @property
    def took_s(self) -> float:
        """The time after the encounter during which the UAV was outside the band."""
        return 0.0 if self.outside_s is None else self.outside_s - self.over_s


class ErrorFigures:
    """Figures of the formation error of one UAV, which `add_errors` fills; `windows` are its encounters."""

    def __init__(
        self, recording: Recording, uav: int, windows: list[Encounter], tolerance: float
    ) -> None:
        self.recording, self.uav, self.tolerance = recording, uav, tolerance
        deadline = recording.scenario.gains.formation.deadline_s
        self.deadline_s = deadline
        self.windows = windows
        start_ns = recording.start_ns
        due_ns = start_ns + nanoseconds(deadline)
        spans = [(seconds(a - start_ns), seconds(b - start_ns)) for a, _, b in windows]
        # Only encounters that begin after the deadline are left out of the settling time.
        self.later = [w for w, (a, _) in zip(windows, spans, strict=True) if a > deadline]
        over = ((w, b) for w, (a, b) in zip(windows, spans, strict=True) if a <= deadline < b)
        # The encounter that lasts over the deadline, which then counts at its end.
        self.over_deadline: Encounter | None
        self.over_deadline, self.due_s = next(over, (None, deadline))
        # The last time above the tolerance, from the deadline until it counts.
        self.arrived_s = deadline
        self.regains = [
            Regain(seconds(one.over_ns - start_ns), seconds(one.back_ns - one.over_ns))
            for one, (_, back_s) in zip(windows, spans, strict=True)
            if back_s > deadline
        ]
        # When the error entered the band for good, without later encounters; None: it ends outside.
        self.settling_s: float | None = 0.0
        # After which time past the deadline it is in the band outside encounters, where one lasts over it; None: never.
        self.regained_s: float | None = 0.0
        self.absent_s = sum(
            seconds(max(min(one.end_ns, recording.end_ns) - max(one.begin_ns, due_ns), 0))
            for one in recording.members.absences[uav]
        )
        self._changes = _changes_due(recording, windows)
        self._at, self._at_due = ValueAt(deadline), ValueAt(self.due_s)
        self.values = [self._at, self._at_due, *(at for _, at in self._changes)]
        self.end_s = self.end_error = np.nan  # of the newest sample
        self.squares = 0.0  # sum of the squared errors after the deadline
        self.after = 0  # number of samples in that sum
        self.start_error = np.nan
        self.band = tolerance
        self.max_after: float | None = None
        self.max_after_all: float | None = None  # inside encounters too
        self.encounter_s = 0.0
        self.excused_outside_s = 0.0  # after the deadline, inside encounters and outside the band
        self.not_finite_s: float | None = None

    @property
    def left_again(self) -> bool:
        """True if the error met the tolerance at the deadline and left the band after it."""
        at, settled = self.at_deadline, self.settling_s
        late = settled is None or settled > self.deadline_s
        return late and at is not None and at <= self.tolerance

    def longest_regain(self) -> Regain | None:
        """Of the encounters that the leg outlasts the one after which the place was regained last."""
        done = [one for one in self.regains if one.over_s + one.promised_s <= self.end_s]
        return max(done, key=lambda one: one.took_s, default=None)

    @property
    def at_deadline(self) -> float | None:
        """The error at the deadline [m]; None when the leg ends before it."""
        if self._at.value is None and self.max_after_all is not None:
            return self.end_error  # the last sample is at the deadline
        return self._at.value

    @property
    def in_place(self) -> bool | None:
        """True if the error was within the tolerance at the deadline; None: not expected then, by the plan."""
        due_ns = self.recording.start_ns + nanoseconds(self.deadline_s)
        if not self.recording.members.expected(self.uav, due_ns):
            return None
        at = self.at_deadline
        return at is not None and at <= self.tolerance

    @property
    def at_changes(self) -> tuple[ChangeError, ...]:
        """The errors when the changes of the shape, or the legs, were due."""
        return tuple(replace(change, error_m=at.value) for change, at in self._changes)

    @property
    def at_due(self) -> float | None:
        """The error when it was due [m]; None when the leg ends before."""
        return self._at_due.value if self.due_s > self.deadline_s else self.at_deadline

    @property
    def rmse_after(self) -> float | None:
        """Root mean square after the deadline, outside encounters."""
        return float(np.sqrt(self.squares / self.after)) if self.after else None


def add_errors(figures: Sequence[ErrorFigures], block: Instants, errors: Array) -> None:
    """Take the next errors (N, T) [m] of the UAVs of these figures."""
    times, stamps, begins = block.times, block.stamps, np.isnan(figures[0].end_s)
    if begins:
        for figure, start_error in zip(figures, errors[:, 0].tolist(), strict=True):
            figure.start_error = start_error
            figure.band = max(figure.tolerance, SHARE_OF_START * start_error)
    due = int(times.searchsorted(figures[0].deadline_s - _EXACT_S))
    outside = errors > np.array([[figure.band] for figure in figures])
    near = inside([figure.windows for figure in figures], stamps)
    late = outside & ~inside([figure.later for figure in figures], stamps)
    excused = outside & near
    excused[:, :due] = False
    fresh = int(begins)  # the first sample of all has no period
    edges = times if begins else np.concatenate(([figures[0].end_s], times))
    period = edges[1:] - edges[:-1]
    after = errors[:, due:]
    squares, largest = after**2, after.max(axis=1, initial=-np.inf).tolist()
    for row, figure in enumerate(figures):
        figure.settling_s = _entered(figure.settling_s, times, late[row])
        kept, square, most = after[row], squares[row], largest[row]
        if kept.size:
            figure.max_after_all = max_of(figure.max_after_all, most)
        if figure.windows:
            there = ~near[row, due:]
            kept, square = kept[there], square[there]
            most = kept.max(initial=-np.inf)
            figure.encounter_s += float(period[near[row, fresh:]].sum())
            figure.excused_outside_s += float(period[excused[row, fresh:]].sum())
        if kept.size:
            figure.max_after = max_of(figure.max_after, most)
            figure.squares += float(square.sum())
            figure.after += kept.size
        for at in figure.values:
            at.add(times, errors[row])
        if figure.over_deadline is not None:
            unexcused = outside[row] & ~near[row]
            unexcused[:due] = False
            figure.regained_s = _entered(figure.regained_s, times, unexcused)
            end = times.searchsorted(figure.due_s, "right")
            above = np.flatnonzero(errors[row, due:end] > figure.tolerance)
            figure.arrived_s = float(times[due + above[-1]]) if above.size else figure.arrived_s
        figure.end_s, figure.end_error = float(times[-1]), float(errors[row, -1])
    _add_regains(figures, times, outside)
    finite = np.isfinite(errors)
    for figure, known in zip(() if finite.all() else figures, finite, strict=False):
        if figure.not_finite_s is None and not known.all():
            figure.not_finite_s = float(times[int(np.argmin(known))])


def _entered(before_s: float | None, times: Array, outside: NDArray[np.bool_]) -> float | None:
    """The last time at which a curve entered its band, with the next samples (T,); None: it ends outside.

    `before_s` is that of the samples before.
    """
    from_end = int(outside[::-1].argmax())
    if outside[-1 - from_end]:
        return float(times[-from_end]) if from_end else None
    return float(times[0]) if before_s is None else before_s


def _add_regains(figures: Sequence[ErrorFigures], times: Array, outside: NDArray[np.bool_]) -> None:
    """Take the next instants (T,) at which the UAVs are outside their bands (N, T)."""
    regains = [(row, regain) for row, of in enumerate(figures) for regain in of.regains]
    over_s = [regain.over_s for _, regain in regains]
    until_s = [regain.over_s + regain.promised_s + _EXACT_S for _, regain in regains]
    begins, ends = times.searchsorted(over_s), times.searchsorted(until_s, "right")
    for (row, regain), begin, end in zip(regains, begins.tolist(), ends.tolist(), strict=True):
        there = np.flatnonzero(outside[row, begin:end])
        if there.size:
            regain.outside_s = float(times[begin + there[-1]])


def _changes_due(
    recording: Recording, windows: list[Encounter]
) -> list[tuple[ChangeError, ValueAt]]:
    """The changes that are due after the deadline of a leg in formation; it counts from the first epoch.

    They are the legs of the mission after the first, or without a mission the changes of the shape.
    """
    scenario, changes = recording.scenario, []
    dues = [
        (number, f"change {number} of the shape", change.at_s + change.over_s)
        for number, change in enumerate(scenario.formation.changes, 1)
    ]
    if scenario.mission is not None:
        dues = [
            (leg.number, f"leg {leg.name}", leg.due_s)
            for leg in scenario.legs
            if leg.number != FIRST
            and not isinstance(leg.leg, LandLeg)
            and not is_cut_short(scenario.legs, leg)
        ]
    before_s = seconds(recording.start_ns - recording.first_ns)
    for number, what, due_s in dues:
        if due_s - before_s <= scenario.gains.formation.deadline_s:
            continue
        due_ns = recording.first_ns + nanoseconds(due_s)
        excused = any(one.begin_ns <= due_ns <= one.back_ns for one in windows)
        changes.append((ChangeError(number, what, due_s, None, excused), ValueAt(due_s - before_s)))
    return changes
