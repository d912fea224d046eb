"""The verdict on a whole recording: one plain object, from which tables and JSON are made.

Flights in one process, bags and sweeps are judged here and nowhere else.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_sim.verdict.coverage import coverages
from ptnsbc_sim.verdict.deadline import (
    MET,
    VIOLATED,
    VOID,
    WORST_FIRST,
    UavVerdict,
    judge,
)
from ptnsbc_sim.verdict.encounters import encounters
from ptnsbc_sim.verdict.error_figures import ErrorFigures
from ptnsbc_sim.verdict.figures import (
    Effort,
    EstimatorError,
    EstimatorErrors,
    effort,
)
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.mission import CUT_SHORT, MissionLegVerdict, mission_legs
from ptnsbc_sim.verdict.recording import (
    COUNTERS,
    NANO,
    Recording,
    VerdictError,
    counter_rise,
    require_all_uavs,
    tolerance_of,
)
from ptnsbc_sim.verdict.separation import Separation, Separations, intrusion, joined

_VIOLATION = COUNTERS.index("priority_violation_max")


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
        """The worst of its UAVs: violated, else missed, else void, else met; a lost UAV does not count."""
        judged = [uav.verdict for uav in self.uavs if not uav.lost or uav.verdict == VIOLATED]
        return VOID if self.reason or not judged else _worst(judged)


@dataclass(frozen=True)
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
    faults: tuple[str, ...]  # that were injected, in words

    @property
    def verdict(self) -> str:
        """Violated when a keep-out was entered in any leg, else the worst of all UAVs and legs: missed, void, met."""
        if any(pair.entered for pair in self.separations):
            return VIOLATED
        legs = [leg.verdict for leg in self.legs]
        return _worst([*legs, *(leg.verdict for leg in self.mission if leg.verdict != CUT_SHORT)])

    @property
    def exit_code(self) -> int:
        """0 when every UAV met its deadline and no keep-out was entered, else 1: void was not shown to be met."""
        return 0 if self.verdict == MET else 1

    def as_json(self) -> dict[str, Any]:
        """The verdict in plain types; a figure that does not exist is null."""
        plain = _plain(dataclasses.asdict(self))
        for entry, leg in zip(plain["legs"], self.legs, strict=True):
            entry["verdict"] = leg.verdict
        return {"verdict": self.verdict, **plain}


def _worst(verdicts: Iterable[str]) -> str:
    found = set(verdicts)
    return next(kind for kind in WORST_FIRST if kind in found)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def verdict_on(recording: Recording, tolerance: float | None = None) -> Verdict:
    """Judge a recording; `tolerance` [m] limits the error at the deadline, by default as in the scenario."""
    with np.errstate(all="ignore"):  # the verdict names what is not finite
        return _verdict_on(recording, tolerance_of(recording, tolerance))


def _verdict_on(recording: Recording, tolerance: float) -> Verdict:
    require_all_uavs(recording)
    scenario = recording.scenario
    estimators = EstimatorErrors(recording)
    legs = _legs(recording, tolerance, estimators)
    found = [effort(recording, uav) for uav in scenario.uav_ids]
    efforts = tuple(one for one in found if one is not None)
    parts = [*(leg.separations for leg in legs), *_without_deadline(recording)]
    separations = tuple(joined(parts))
    start_ns, end_ns = recording.start_ns, legs[0].end_ns
    counters = recording.counters.values()
    return Verdict(
        scenario=scenario.name,
        plant=scenario.plant.kind,
        task=scenario.task_name,
        profile=scenario.gains.profile,
        avoidance=scenario.formation.avoidance,
        judged_by=recording.judged_by,
        epoch_s=start_ns * NANO,
        duration_s=legs[0].verdict.duration_s,
        uavs=legs[0].verdict.uavs,
        efforts=efforts,
        separations=separations,
        estimators=tuple(estimators.found()),
        energy=sum(one.energy for one in efforts),
        inside_keep_out_s=sum(pair.inside_s for pair in separations),
        missed_ticks=int(
            sum(counter_rise(one, "missed_ticks", start_ns, end_ns) for one in counters)
        ),
        priority_violation_m_s=max(
            (float(one.rows(one.size - 1, one.size).values[0, _VIOLATION]) for one in counters),
            default=0.0,
        ),
        latency_ms=dict(recording.latency),
        legs=tuple(leg.verdict for leg in legs),
        mission=mission_legs(
            recording,
            [leg.verdict.uavs for leg in legs],
            [pair for part in parts for pair in part],
            tolerance,
        ),
        faults=(*(fault.text for fault in (scenario.faults or ())), *recording.injected),
    )


class _JudgedLeg(NamedTuple):
    """A leg, the last instant of it that is judged, and its separations."""

    verdict: LegVerdict
    end_ns: int
    separations: list[Separation]


def _legs(recording: Recording, tolerance: float, of_first: EstimatorErrors) -> list[_JudgedLeg]:
    """All legs; `of_first` takes the positions of the first one."""
    found = []
    for number in range(len(recording.forms)):
        leg = dataclasses.replace(recording, leg=number)
        try:
            found.append(_leg(leg, tolerance, None if number else of_first))
        except VerdictError as error:
            if number == 0:
                raise
            epoch_s = leg.start_ns * NANO
            void = LegVerdict(number + 1, epoch_s, 0.0, str(error), ())
            found.append(_JudgedLeg(void, leg.start_ns, []))
    return found


def _leg(recording: Recording, tolerance: float, estimators: EstimatorErrors | None) -> _JudgedLeg:
    uavs = recording.scenario.uav_ids
    windows = encounters(recording)
    figures = {uav: ErrorFigures(recording, uav, windows[uav], tolerance) for uav in uavs}
    covers = coverages(recording)
    pairs = Separations(recording)
    end_ns = recording.start_ns
    for grid in recording.grids():
        positions = recording.positions(grid)
        for uav, error in formation_errors(recording, grid, positions).items():
            figures[uav].add(grid, error)
        pairs.add(grid, positions)
        if estimators is not None:
            estimators.add(grid, positions)
        end_ns = int(grid[-1])
    separations = pairs.found()
    leg = LegVerdict(
        recording.leg + 1,
        recording.start_ns * NANO,
        float(end_ns - recording.start_ns) * NANO,
        "",
        tuple(
            judge(recording, uav, figures[uav], tolerance, covers, intrusion(separations, uav))
            for uav in uavs
        ),
    )
    return _JudgedLeg(leg, end_ns, separations)


def _without_deadline(recording: Recording) -> Iterator[list[Separation]]:
    """The separations of the legs that have no deadline: hold and land."""
    for start_ns, end_ns in recording.other_legs_ns:
        pairs = Separations(recording)
        for grid in recording.grids_between(start_ns, end_ns):
            pairs.add(grid, recording.positions(grid))
        yield pairs.found()
