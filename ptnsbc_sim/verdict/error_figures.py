"""Figures of the formation error of one UAV: settling, and the errors when something was due."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.mission.legs import FIRST, LandLeg, is_cut_short
from ptnsbc_sim.verdict.encounters import Encounter, inside
from ptnsbc_sim.verdict.recording import Instants, Recording, counter_rise
from ptnsbc_sim.verdict.track import ValueAt, max_of

SHARE_OF_START = 0.02
"""Share of the start error that widens the band of the settling time."""

_EXACT_S = 1e-9
_NONE = np.empty(0)


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


def _entered(
    before_s: float | None, times: Array, outside: NDArray[np.bool_], first: int = 0
) -> float | None:
    """The last time at which a curve entered its band, with the next samples (T,); None: it ends outside.

    `before_s` is that of the samples before; before number `first` none is outside.
    """
    latest_first = outside[first:][::-1]
    if latest_first.any():
        after = times.size - int(latest_first.argmax())
        return float(times[after]) if after < times.size else None
    return float(times[0]) if before_s is None else before_s


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
    """Figures of the formation error of one UAV, which arrives block by block; `windows` are its encounters."""

    def __init__(
        self, recording: Recording, uav: int, windows: list[Encounter], tolerance: float
    ) -> None:
        self.recording, self.uav = recording, uav
        deadline = recording.scenario.gains.formation.deadline_s
        self.deadline_s = deadline
        self._windows = windows
        start_ns = recording.start_ns
        spans = [(seconds(a - start_ns), seconds(b - start_ns)) for a, _, b in self._windows]
        # Only encounters that begin after the deadline are left out of the settling time.
        self._later = [w for w, (a, _) in zip(self._windows, spans, strict=True) if a > deadline]
        self.tolerance = tolerance
        over = ((w, b) for w, (a, b) in zip(self._windows, spans, strict=True) if a <= deadline < b)
        # The encounter that lasts over the deadline, which then counts at its end.
        self.over_deadline: Encounter | None
        self.over_deadline, self.due_s = next(over, (None, deadline))
        # The last time above the tolerance, from the deadline until it counts.
        self.arrived_s = deadline
        self.regains = [
            Regain(seconds(one.over_ns - start_ns), seconds(one.back_ns - one.over_ns))
            for one, (_, back_s) in zip(self._windows, spans, strict=True)
            if back_s > deadline
        ]
        self._at, self._at_due = ValueAt(deadline), ValueAt(self.due_s)
        # When the error entered the band for good, without later encounters; None: it ends outside.
        self.settling_s: float | None = 0.0
        # After which time past the deadline it is in the band outside encounters; None: never.
        self.regained_s: float | None = 0.0
        self._changes = _changes_due(recording, self._windows)
        due_ns = recording.start_ns + nanoseconds(deadline)
        self.absent_s = sum(
            seconds(max(min(one.end_ns, recording.end_ns) - max(one.begin_ns, due_ns), 0))
            for one in recording.members.absences[uav]
        )
        self._last = _NONE  # time and error of the newest sample
        self._squares = 0.0  # sum of the squared errors after the deadline
        self._after = 0  # number of samples in that sum
        self.start_error = np.nan
        self.band = tolerance
        self.max_after: float | None = None
        self.max_after_all: float | None = None  # inside encounters too
        self.encounter_s = 0.0
        self.excused_outside_s = 0.0  # after the deadline, inside encounters and outside the band
        self.not_finite_s: float | None = None

    def add(self, block: Instants, error: Array) -> None:
        """Take the next errors (T,) [m]."""
        times = block.times
        if not self._last.size:
            self.start_error = float(error[0])
            self.band = max(self.tolerance, SHARE_OF_START * self.start_error)
        due = int(times.searchsorted(self.deadline_s - _EXACT_S))
        outside = late = unexcused = np.asarray(error > self.band)
        after = error[due:]
        if self._windows:
            near = inside(self._windows, block.stamps)
            late, unexcused = outside & ~inside(self._later, block.stamps), outside & ~near
            after = after[~near[due:]]
            period = np.diff(times, prepend=self._last[:1])
            fresh = times.size - period.size  # the first sample of all has no period
            self.encounter_s += float(np.sum(period[near[fresh:]]))
            excused = near & outside
            excused[:due] = False
            self.excused_outside_s += float(np.sum(period[excused[fresh:]]))
        self.settling_s = _entered(self.settling_s, times, late)
        self.regained_s = _entered(self.regained_s, times, unexcused, due)
        if error[due:].size:
            self.max_after_all = _larger(self.max_after_all, error[due:])
        if after.size:
            self.max_after = _larger(self.max_after, after)
            self._squares += float(np.sum(after**2))
            self._after += after.size
        self._at.add(times, error)
        self._at_due.add(times, error)
        for _, at in self._changes:
            at.add(times, error)
        if self.over_deadline is not None:
            late_s = times[due:][(times[due:] <= self.due_s) & (error[due:] > self.tolerance)]
            self.arrived_s = float(late_s[-1]) if late_s.size else self.arrived_s
        for one in self.regains:
            span = (times >= one.over_s) & (times <= one.over_s + one.promised_s + _EXACT_S)
            there = np.flatnonzero(outside & span)
            if there.size:
                one.outside_s = float(times[there[-1]])
        finite = np.isfinite(error)
        if self.not_finite_s is None and not finite.all():
            self.not_finite_s = float(times[int(np.argmin(finite))])
        self._last = np.array([times[-1], error[-1]])

    def rise(self, name: str, begin_s: float, end_s: float) -> float:
        """Rise of a counter of the UAV between two times after the epoch."""
        begin_ns, end_ns = (self.recording.start_ns + nanoseconds(t) for t in (begin_s, end_s))
        return counter_rise(self.recording, self.uav, name, begin_ns, end_ns)

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return float(self._last[0])

    @property
    def left_again(self) -> bool:
        """True if the error met the tolerance at the deadline and left the band after it."""
        at, settled = self.at_deadline, self.settling_s
        late = settled is None or settled > self.deadline_s
        return late and at is not None and at <= self.tolerance

    def unregained(self) -> Regain | None:
        """The first encounter after which the place was not regained in the recovery time; None: none."""
        period_s = seconds(self.recording.scenario.timing.dt_ns)
        for one in self.regains:
            if one.outside_s is not None and one.took_s > one.promised_s - 1.5 * period_s:
                return one
        return None

    def longest_regain(self) -> Regain | None:
        """Of the encounters that the leg outlasts the one after which the place was regained last."""
        done = [one for one in self.regains if one.over_s + one.promised_s <= self.end_s]
        return max(done, key=lambda one: one.took_s, default=None)

    @property
    def at_deadline(self) -> float | None:
        """The error at the deadline [m]; None when the leg ends before it."""
        if self._at.value is None and self.max_after_all is not None:
            return float(self._last[1])  # the last sample is at the deadline
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
        return float(np.sqrt(self._squares / self._after)) if self._after else None


def _larger(before: float | None, values: Array) -> float:
    """The largest of the values (T,), and of those before; NaN when one of them is."""
    return max_of(-np.inf if before is None else before, values.max())


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
