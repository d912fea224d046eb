"""A recording with all that figures need beside it, or the reason why it cannot be judged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.commands.verify import ReadOptions
from ptnsbc_tools.plotting.status import StatusSeries, read_status
from ptnsbc_tools.verdict import Recording, Track, Verdict, verdict_on
from ptnsbc_tools.verdict.recording import NANO, tolerance_of
from ptnsbc_tools.verdict.windows import Window, joined, rises

_BEFORE_S = 2.0  # shown of the time before the epoch


@dataclass(frozen=True)
class Shown:
    """What of a flight is shown."""

    recording: Recording
    status: StatusSeries
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

    def _shown(self) -> tuple[Track, int, int]:
        """Whose stamps are the instants shown, and which of them."""
        tracks = [self.recording.odometry[uav] for uav in self.uavs]
        last = min(track.last_ns for track in tracks)
        first = max(
            min(track.first_ns for track in tracks),
            self.recording.start_ns - round(_BEFORE_S / NANO),
        )
        begin, end = tracks[0].span(first, last)
        return (tracks[0], begin, end) if end - begin > 1 else (tracks[0], 0, tracks[0].size)

    @property
    def samples(self) -> int:
        """How many instants are shown."""
        _, begin, end = self._shown()
        return end - begin

    @property
    def window_ns(self) -> Window:
        """First and last instant shown: from just before the epoch as long as every UAV is there, or any is."""
        track, begin, end = self._shown()
        return track.rows(begin, begin + 1).first_ns, track.rows(end - 1, end).last_ns

    def grids(self) -> Iterator[NDArray[np.int64]]:
        """Instants shown, block by block."""
        track, begin, end = self._shown()
        for block in track.blocks(begin, end):
            yield block.t_ns

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


def shown(recording: Recording, status: StatusSeries, tolerance_m: float | None = None) -> Shown:
    """Judge a recording, or say why not; the tolerance is the scenario's by default."""
    limit_m = tolerance_of(recording, tolerance_m)
    try:
        verdict, problem = verdict_on(recording, limit_m), ""
    except PtnsbcError as error:
        verdict, problem = None, str(error)
    return Shown(recording, status, limit_m, verdict, problem)


def read_shown(bag: Path, choice: ReadOptions) -> Shown:
    """Read a bag and judge it.

    Raises:
        PtnsbcError: No bag, cut, damaged, or without a scenario.
    """
    return shown(choice.read(bag), read_status(bag), choice.tolerance)
