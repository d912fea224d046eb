"""A recording with all that figures need beside it, or the reason why it cannot be judged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.charts.status import Status, read_status
from ptnsbc_tools.verdict import Recording, Verdict, verdict_on
from ptnsbc_tools.verdict.recording import NANO
from ptnsbc_tools.verdict.windows import Window, joined, rises
from ptnsbc_tools.verify import Choice

_BEFORE_S = 2.0  # shown of the time before the epoch


@dataclass(frozen=True)
class Shown:
    """What of a flight is shown."""

    recording: Recording
    status: Status
    tolerance_m: float
    verdict: Verdict | None
    problem: str  # why there is no verdict, else empty

    @property
    def scenario(self) -> Scenario:
        """As it was flown."""
        return self.recording.scenario

    @property
    def uavs(self) -> tuple[int, ...]:
        """Those whose odometry was recorded."""
        return tuple(uav for uav in self.scenario.uav_ids if uav in self.recording.odometry)

    @property
    def has_leader(self) -> bool:
        """Whether formation errors can be measured."""
        return self.scenario.leader_id in self.recording.odometry

    def grid(self) -> NDArray[np.int64]:
        """Instants shown: from just before the epoch as long as every UAV is there, or any is."""
        tracks = [self.recording.odometry[uav] for uav in self.uavs]
        first = min(int(track.t_ns[0]) for track in tracks)
        last = min(int(track.t_ns[-1]) for track in tracks)
        start = max(first, self.recording.start_ns - round(_BEFORE_S / NANO))
        stamps = tracks[0].t_ns
        chosen = stamps[(stamps >= start) & (stamps <= last)]
        return chosen if chosen.size > 1 else stamps

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return self.recording.times(stamps)

    def seconds(self, window: Window) -> tuple[float, float]:
        """A window in seconds after the epoch."""
        begin, end = ((edge - self.recording.start_ns) * NANO for edge in window)
        return begin, end

    def avoiding(self, uav: int) -> list[Window]:
        """Spans in which a UAV kept clear of something."""
        counters = self.recording.counters.get(uav)
        return joined(rises(counters)) if counters is not None else []


def shown(recording: Recording, status: Status, tolerance_m: float | None = None) -> Shown:
    """Judge a recording, or say why not; the tolerance is the scenario's by default."""
    if tolerance_m is None:
        tolerance_m = recording.scenario.file.formation.tolerance_m
    try:
        verdict, problem = verdict_on(recording, tolerance_m), ""
    except PtnsbcError as error:
        verdict, problem = None, str(error)
    return Shown(recording, status, tolerance_m, verdict, problem)


def read_shown(bag: Path, choice: Choice) -> Shown:
    """Read a bag and judge it.

    Raises:
        PtnsbcError: No bag, cut, damaged, or without a scenario.
    """
    return shown(choice.read(bag), read_status(bag), choice.tolerance)
