"""The verdict on a whole recording: one plain object, from which tables and JSON are made.

Flights in one process, bags and sweeps are judged here and nowhere else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario.mission.legs import FIRST, LandLeg, ScheduledLeg, is_cut_short
from ptnsbc_sim.verdict.deadline import (
    KEPT,
    MET,
    MET_LATE,
    MISSED,
    VIOLATED,
    VOID,
    WORST_FIRST,
    UavVerdict,
    coverages,
    judge,
    missing,
)
from ptnsbc_sim.verdict.encounters import encounters
from ptnsbc_sim.verdict.error_figures import ErrorFigures, add_errors
from ptnsbc_sim.verdict.formation_error import EstimatorError, EstimatorErrors, formation_errors
from ptnsbc_sim.verdict.recording import (
    FORMATION,
    Recording,
    VerdictError,
    counter_rises,
    require_all_uavs,
    seconds_since,
    tolerance_of,
)
from ptnsbc_sim.verdict.separation import Separation, intrusion, joined, separations
from ptnsbc_sim.verdict.track import BLOCK, lengths, together


@dataclass(frozen=True)
class Effort:
    """The input that one UAV commanded."""

    uav: int
    initial_input: float  # |(force, torque)| at the epoch [N, N m]
    initial_above_hover_n: float  # force at the epoch minus the weight
    peak_input: float  # largest |(force, torque)|
    peak_force_n: float
    peak_at_s: float
    energy: float  # integral of |u|^2 (54) [N^2 s]
    energy_above_hover: float  # the same of the force above the weight, and of the torque
    missing: int  # wrench messages missing of one per odometry sent or per control period


def efforts(recording: Recording) -> dict[int, Effort]:
    """Input figures of the UAVs whose wrench was recorded in the judged time.

    An input acts until the next one that is recorded: a missing message takes no time out of an integral.
    """
    scenario, start_ns, end_ns = recording.scenario, recording.start_ns, recording.end_ns
    found: dict[int, Effort] = {}
    for uavs, track in together(recording.wrench):
        masses = np.array([scenario.vehicle(uav).mass_kg for uav in uavs])
        weights = scenario.world.gravity_m_s2 * masses
        initial: tuple[Array, Array] | None = None  # |u| and force above the weight
        peak = peak_force = np.full(len(uavs), -np.inf)
        peak_at_s, energy, above_hover = np.zeros((3, len(uavs)))
        # The last input before the epoch acts at the epoch.
        first, end = max(track.index(start_ns, "right") - 1, 0), track.index(end_ns, "right")
        for begin in range(first, end, BLOCK):
            last = min(begin + BLOCK, end)
            block = track.rows(begin, last)
            next_ns = int(track.t_ns[last]) if last < end else end_ns
            values = np.ascontiguousarray(block.values.T)  # (6, N, T), axis by axis in memory
            force, torque = lengths(values[:3]), lengths(values[3:])
            edges = np.concatenate((block.t_ns, [next_ns]))
            edges[0] = max(edges[0], start_ns)
            lasting_s = seconds(edges[1:] - edges[:-1])
            square = torque**2
            above_hover += (((force - weights[:, None]) ** 2 + square) * lasting_s).sum(axis=1)
            square += force**2
            energy += (square * lasting_s).sum(axis=1)
            inside = block.index(start_ns, "left")
            if inside == block.size:
                continue
            force, torque, square = force[:, inside:], torque[:, inside:], square[:, inside:]
            if initial is None:
                initial = np.hypot(force[:, 0], torque[:, 0]), force[:, 0] - weights
            peak_force = np.maximum(peak_force, force.max(axis=1))
            low = square < _NEARLY * square.max(axis=1, keepdims=True)  # of a NaN nothing is low
            whole = np.hypot(force, torque, out=np.full_like(force, -np.inf), where=~low)
            highest = whole.argmax(axis=1)  # the first NaN, if there is one
            most = whole[np.arange(len(uavs)), highest]
            higher = (most > peak) | (np.isnan(most) > np.isnan(peak))
            peak = np.where(higher, most, peak)
            times = seconds_since(block.t_ns[inside:], start_ns)
            peak_at_s = np.where(higher, times[highest], peak_at_s)
        if initial is not None:
            figures = (*initial, peak, peak_force, peak_at_s, energy, above_hover)
            lost = missing(recording, uavs, track)
            for uav, of in zip(uavs, np.array(figures).T.tolist(), strict=True):
                found[uav] = Effort(uav, *(*of, lost[uav]))
    return {uav: found[uav] for uav in scenario.uav_ids if uav in found}


_EXACT_S = 1e-9
_NEARLY = 1.0 - 1e-9  # of a square, below which its root cannot be the largest by rounding
_VIOLATION = COUNTERS.index("priority_violation_max")


@dataclass(frozen=True)
class InTime:
    """The UAVs that were in place at the chosen deadline, of those that were to be, whatever excuses the others."""

    count: int
    of: int


@dataclass(frozen=True)
class LegVerdict:
    """The verdict on the deadline of one formation leg, which begins at an epoch with that name."""

    number: int  # from 1
    epoch_s: float
    duration_s: float  # judged
    reason: str  # why the leg as a whole is void, empty when it is not
    uavs: tuple[UavVerdict, ...]

    @property
    def verdict(self) -> str:
        """The worst of its UAVs, by `WORST_FIRST`; a lost UAV does not count."""
        judged = [uav.verdict for uav in self.uavs if not uav.lost or uav.verdict == VIOLATED]
        return VOID if self.reason or not judged else _worst(judged)

    @property
    def in_place(self) -> InTime:
        """The UAVs that were in place at the deadline of this leg."""
        expected = [uav.in_place for uav in self.uavs if uav.in_place is not None]
        return InTime(sum(expected), len(expected))


CUT_SHORT = "cut short"
"""The verdict on a leg that gave way to another one before it was due: it is not judged."""


@dataclass(frozen=True)
class MissionLegVerdict:
    """The verdict on one leg of the mission. Times in seconds after the first epoch, the error in metres."""

    number: int  # from 1; 0 for the one that a cancelled leg gave way to
    name: str
    kind: str
    begin_s: float
    due_s: float
    # the largest one when it was due; of a landing the largest height above the ground
    error_m: float | None
    uav: int | None  # that had it
    verdict: str  # met | met late | missed | violated | void | cut short
    reason: str  # why not met, or why late; empty when met


@dataclass(frozen=True, repr=False)
class Verdict:
    """All results of a recording: deadlines, input, separations, estimators, timing."""

    scenario: str
    plant: str
    task: str
    profile: str
    avoidance: str
    judged_by: str  # truth | odometry: the source of positions
    epoch_s: float
    duration_s: float
    uavs: tuple[UavVerdict, ...]
    efforts: tuple[Effort, ...]
    separations: tuple[Separation, ...]  # of all legs, the smallest margin first
    estimators: tuple[EstimatorError, ...]
    energy: float  # (54), all UAVs
    inside_keep_out_s: float  # summed over pairs and legs
    missed_ticks: int
    priority_violation_m_s: float
    latency_ms: dict[str, float]
    legs: tuple[LegVerdict, ...]  # all formation legs; the figures above are of the first
    mission: tuple[MissionLegVerdict, ...]  # the legs of the mission; empty without one
    faults: tuple[str, ...]  # of the scenario, and what was damaged, in words

    @property
    def verdict(self) -> str:
        """Violated when a keep-out was entered in any leg, else the worst of all UAVs and legs, by `WORST_FIRST`."""
        if any(pair.entered for pair in self.separations):
            return VIOLATED
        legs = [leg.verdict for leg in self.legs]
        return _worst([*legs, *(leg.verdict for leg in self.mission if leg.verdict != CUT_SHORT)])

    @property
    def exit_code(self) -> int:
        """0 when every UAV kept its promise and no keep-out was entered, else 1: void was not shown to be met."""
        return 0 if self.verdict in KEPT else 1

    @property
    def in_place(self) -> InTime:
        """The UAVs that were in place at the deadline of the first leg."""
        return self.legs[0].in_place

    def __repr__(self) -> str:
        there = f"{self.in_place.count} of {self.in_place.of}"
        return f"<Verdict on {self.scenario}: {self.verdict}, {there} in place at the deadline>"

    def strict(self) -> Verdict:
        """The verdict of those to whom late is missed, whatever the UAVs gave way to."""

        def judged(part: Any) -> Any:
            return dataclasses.replace(part, verdict=MISSED) if part.verdict == MET_LATE else part

        uavs, mission = tuple(map(judged, self.uavs)), tuple(map(judged, self.mission))
        legs = (dataclasses.replace(leg, uavs=tuple(map(judged, leg.uavs))) for leg in self.legs)
        return dataclasses.replace(self, uavs=uavs, legs=tuple(legs), mission=mission)

    def as_json(self) -> dict[str, Any]:
        """The verdict in plain types; a figure that does not exist is null."""
        told = plain(dataclasses.asdict(self))
        for entry, leg in zip(told["legs"], self.legs, strict=True):
            entry |= {"verdict": leg.verdict, "in_place": vars(leg.in_place)}
        return {"verdict": self.verdict, "in_place": vars(self.in_place), **told}


def _worst(verdicts: Iterable[str]) -> str:
    found = set(verdicts)
    return next(kind for kind in WORST_FIRST if kind in found)


def plain(value: Any) -> Any:
    """A value as JSON has it, whose numbers are all finite: None for others."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@np.errstate(all="ignore")  # the verdict names what is not finite
def verdict_on(recording: Recording, tolerance: float | None = None) -> Verdict:
    """Judge a recording; `tolerance` [m] limits the error at the deadline, by default as in the scenario."""
    require_all_uavs(recording)
    tolerance = tolerance_of(recording, tolerance)
    scenario, counters = recording.scenario, recording.counters
    estimators = EstimatorErrors(recording)
    first, pairs = _leg(recording, tolerance, estimators)
    legs, parts = [first], [pairs]
    for number in range(1, len(recording.forms)):
        later = dataclasses.replace(recording, leg=number)
        try:
            leg, pairs = _leg(later, tolerance)
        except VerdictError as error:
            leg, pairs = LegVerdict(number + 1, seconds(later.start_ns), 0.0, str(error), ()), []
        legs.append(leg)
        parts.append(pairs)
    for start_ns, end_ns in legs_without_deadline(recording):
        blocks = recording.blocks(start_ns, end_ns)
        parts.append(joined(separations(recording, block) for block in blocks))
    inputs = tuple(efforts(recording).values())
    closest = tuple(joined(parts))
    begin_ns, end_ns = recording.start_ns, recording.start_ns + nanoseconds(first.duration_s)
    rises = counter_rises(recording, begin_ns, end_ns).values()
    violations = (float(track.values[-1, ..., _VIOLATION].max()) for _, track in together(counters))
    return Verdict(
        scenario=scenario.name,
        plant=scenario.plant.kind,
        task=scenario.task_name,
        profile=scenario.gains.profile,
        avoidance=scenario.formation.avoidance,
        judged_by=recording.judged_by,
        epoch_s=seconds(recording.start_ns),
        duration_s=first.duration_s,
        uavs=first.uavs,
        efforts=inputs,
        separations=closest,
        estimators=tuple(estimators.results()),
        energy=sum(of.energy for of in inputs),
        inside_keep_out_s=sum(pair.inside_s for pair in closest),
        missed_ticks=int(sum(of["missed_ticks"] for of in rises)),
        priority_violation_m_s=max(violations, default=0.0),
        latency_ms=dict(recording.latency),
        legs=tuple(legs),
        mission=_mission_legs(recording, legs, [p for part in parts for p in part], tolerance),
        faults=(*(fault.text for fault in scenario.faults), *recording.left_out),
    )


def _leg(
    recording: Recording, tolerance: float, estimators: EstimatorErrors | None = None
) -> tuple[LegVerdict, list[Separation]]:
    """The verdict on a leg, and its separations."""
    windows, uavs = encounters(recording), recording.scenario.uav_ids
    figures = [ErrorFigures(recording, uav, windows[uav], tolerance) for uav in uavs]
    covers, parts, start_ns = coverages(recording), [], recording.start_ns
    for block in recording.blocks():
        add_errors(figures, block, formation_errors(recording, block))
        parts.append(separations(recording, block))
        if estimators is not None:
            estimators.add(block)
        end_ns = int(block.stamps[-1])
    pairs = joined(parts)
    entered = [pair for pair in pairs if pair.entered]
    judged = tuple([judge(of, covers, intrusion(entered, of.uav)) for of in figures])
    duration_s = float(seconds(end_ns - start_ns))
    leg = LegVerdict(recording.leg + 1, seconds(start_ns), duration_s, "", judged)
    return leg, pairs


def legs_without_deadline(recording: Recording) -> list[tuple[int, int]]:
    """Begin and end [ns] of the legs hold and land, as far as they are recorded; none in a window."""
    if recording.window_s is not None:
        return []
    first_ns, last_ns = recording.first_ns, recording.last_ns
    ends = [*(t0_ns for t0_ns, _ in recording.epochs[1:]), last_ns]
    spans = zip(recording.epochs, ends, strict=False)  # without epochs there are no spans
    legs = [(t0_ns, min(end_ns, last_ns)) for (t0_ns, leg), end_ns in spans if leg != FORMATION]
    return [(t0_ns, end_ns) for t0_ns, end_ns in legs if first_ns <= t0_ns <= end_ns]


class _Error(NamedTuple):
    """The error of a UAV when a leg of the mission was due."""

    uav: int
    error_m: float
    excused: bool


def _mission_legs(
    recording: Recording,
    judged: Sequence[LegVerdict],
    pairs: Iterable[Separation],
    tolerance: float,
) -> tuple[MissionLegVerdict, ...]:
    """The verdicts on the legs of the mission that are due before the flight ends, or were cut short."""
    scenario = recording.scenario
    if not scenario.legs:
        return ()
    # the last instant of the flight
    end_s = (scenario.timing.ticks - 1) * seconds(scenario.timing.dt_ns)
    end_s = end_s if recording.window_s is None else min(end_s, recording.window_s)
    until_s = [*(leg.begin_s for leg in scenario.legs[1:]), np.inf]
    verdicts = []
    for leg, next_s in zip(scenario.legs, until_s, strict=True):
        if leg.due_s > end_s + _EXACT_S and not is_cut_short(scenario.legs, leg):
            continue
        errors = _errors(recording, leg, judged, tolerance)
        worst = max(errors or (), key=lambda error: error.error_m, default=None)
        # An error that is no number is off too: a comparison with NaN is false.
        off = [of for of in errors or () if not of.error_m <= tolerance]
        late = [of for of in off if not of.excused]
        due_ns = recording.first_ns + nanoseconds(leg.due_s)
        gave_way = [of for of in off if of.excused and recording.members.expected(of.uav, due_ns)]
        entered = [p for p in pairs if p.entered and leg.begin_s <= p.at_s < next_s]
        verdict, reason = MET, ""
        if entered:
            pair = min(entered, key=lambda pair: pair.distance_m - pair.keep_out_m)
            verdict = VIOLATED
            reason = f"{pair.first} {pair.distance_m:.3f} m from {pair.second} at {pair.at_s:.2f} s"
        elif late:
            where = "above the ground" if isinstance(leg.leg, LandLeg) else "off"
            verdict = MISSED
            reason = (
                f"{_named(late)} {where} at {leg.due_s:.2f} s, expected at most {tolerance:g} m"
            )
        elif errors is None:
            verdict, reason = CUT_SHORT, "by an operator"
        elif not errors:
            last_s = seconds(recording.last_ns - recording.first_ns)
            verdict = VOID
            reason = f"the recording ends after {last_s:.2f} s, it was due at {leg.due_s:.2f} s"
        elif gave_way:
            verdict = MET_LATE
            reason = f"{_named(gave_way)} off at {leg.due_s:.2f} s, in an encounter"
        error_m, uav = (None, None) if worst is None else (worst.error_m, worst.uav)
        times_s = leg.begin_s, leg.due_s
        about = leg.number, leg.name, leg.leg.kind
        verdicts.append(MissionLegVerdict(*about, *times_s, error_m, uav, verdict, reason))
    return tuple(verdicts)


def _named(errors: Iterable[_Error]) -> str:
    return ", ".join(f"UAV {error.uav} {error.error_m:.3f} m" for error in errors)


def _errors(
    recording: Recording, leg: ScheduledLeg, judged: Sequence[LegVerdict], tolerance: float
) -> list[_Error] | None:
    """The known errors of all UAVs when a leg was due; None: a later leg took its place before."""
    if leg.number == FIRST:
        return [
            _Error(uav.uav, uav.error_at_deadline_m, uav.due_s > uav.deadline_s)
            for uav in judged[0].uavs
            if uav.error_at_deadline_m is not None
        ]
    if isinstance(leg.leg, LandLeg):
        due_ns = recording.first_ns + nanoseconds(leg.due_s)
        return _heights(recording, due_ns, leg.leg.ground_m, tolerance)
    if is_cut_short(recording.scenario.legs, leg):
        return None
    return [
        _Error(uav.uav, due.error_m, due.excused)
        for of_leg in judged
        for uav in of_leg.uavs
        for due in uav.changes
        if due.number == leg.number and due.due_s == leg.due_s and due.error_m is not None
    ]


def _heights(recording: Recording, due_ns: int, ground_m: float, tolerance: float) -> list[_Error]:
    """The heights above the ground of all UAVs when they had to be down; none when the record of one ends in the air.

    The bridge of a real vehicle that is down and disarmed ends, and with it the record, before the landing is due.
    """
    tracks = recording.truth if recording.judged_by == "truth" else recording.odometry
    heights = []
    for uav in recording.scenario.uav_ids:
        at_ns = min(due_ns, tracks[uav].last_ns)
        height_m = max(float(tracks[uav].at(np.array([at_ns]))[0, 2]) - ground_m, 0.0)
        if at_ns < due_ns and not height_m <= tolerance:
            return []
        heights.append(_Error(uav, height_m, False))
    return heights
