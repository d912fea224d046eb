"""The verdict on a whole recording, as one plain object that tables and JSON are made from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptnsbc_tools.limits import TOLERANCE_M
from ptnsbc_tools.verdict.deadline import (
    MET,
    MISSED,
    VOID,
    UavVerdict,
    formation_errors,
    judge,
)
from ptnsbc_tools.verdict.figures import (
    Effort,
    EstimatorError,
    Separation,
    effort,
    estimator_error,
    separations,
)
from ptnsbc_tools.verdict.recording import NANO, Recording, complete


@dataclass(frozen=True)
class Verdict:
    """Everything that a recording shows about its deadline and what it cost."""

    scenario: str
    plant: str
    task: str
    profile: str
    avoidance: str
    epoch_s: float
    duration_s: float
    uavs: tuple[UavVerdict, ...]
    efforts: tuple[Effort, ...]
    separations: tuple[Separation, ...]  # worst margin first
    estimators: tuple[EstimatorError, ...]
    energy: float  # (54), all UAVs
    inside_keep_out_s: float  # summed over pairs
    missed_ticks: int
    priority_violation_m_s: float
    latency_ms: dict[str, float]

    @property
    def verdict(self) -> str:
        """The worst of all UAVs: missed, else void, else met."""
        found = {uav.verdict for uav in self.uavs}
        return next(kind for kind in (MISSED, VOID, MET) if kind in found)

    @property
    def exit_code(self) -> int:
        """0 when every UAV met its deadline, else 1: what is void was not shown to be met."""
        return 0 if self.verdict == MET else 1

    def as_json(self) -> dict[str, Any]:
        """Plain types only; a figure that does not exist is null."""
        plain = _plain(dataclasses.asdict(self))
        return {"verdict": self.verdict, **plain}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def verdict_on(recording: Recording, tolerance: float = TOLERANCE_M) -> Verdict:
    """Judge a recording; `tolerance` [m] is the hard limit at the deadline."""
    with np.errstate(all="ignore"):  # what is not finite is named in the verdict
        return _verdict_on(recording, tolerance)


def _verdict_on(recording: Recording, tolerance: float) -> Verdict:
    scenario = complete(recording).scenario
    grid = recording.grid()
    positions = recording.positions(grid)
    errors = formation_errors(recording, grid, positions)
    leader = positions[scenario.leader_id]
    efforts = [effort(recording, uav) for uav in scenario.uav_ids]
    known = tuple(one for one in efforts if one is not None)
    pairs = separations(recording, grid, positions)
    estimators = [estimator_error(recording, grid, leader, uav) for uav in scenario.followers]
    counters = recording.counters.values()
    return Verdict(
        scenario=scenario.name,
        plant=scenario.plant_kind,
        task=scenario.file.formation.task,
        profile=scenario.gains.profile,
        avoidance=scenario.file.formation.avoidance,
        epoch_s=recording.start_ns * NANO,
        duration_s=float(grid[-1] - recording.start_ns) * NANO,
        uavs=tuple(judge(recording, grid, uav, errors[uav], tolerance) for uav in scenario.uav_ids),
        efforts=known,
        separations=tuple(pairs),
        estimators=tuple(one for one in estimators if one is not None),
        energy=sum(one.energy for one in known),
        inside_keep_out_s=sum(pair.inside_s for pair in pairs),
        missed_ticks=int(
            sum(one.gained("missed_ticks", recording.start_ns, int(grid[-1])) for one in counters)
        ),
        priority_violation_m_s=max(
            (float(one.priority_violation_max[-1]) for one in counters if one.t_ns.size),
            default=0.0,
        ),
        latency_ms=dict(recording.latency),
    )
