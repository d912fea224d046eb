"""A recording with the data that figures need, and its verdict or the reason why there is none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording, Track, Verdict, verdict_on
from ptnsbc_sim.verdict.encounters import Window, merged, rising
from ptnsbc_sim.verdict.recording import NANO, seconds, tolerance_of
from ptnsbc_tools.reading.bag_reader import ReadOptions, read_recording
from ptnsbc_tools.reading.diagnostics import StatusSeries, read_status

_BEFORE_S = 2.0  # shown of the time before the epoch


@dataclass(frozen=True)
class FlightView:
    """The part of a flight that is shown."""

    recording: Recording
    status: StatusSeries
    tolerance_m: float
    verdict: Verdict | None
    problem: str  # why there is no verdict, else empty
    bag: Path | None = None

    @property
    def name(self) -> str:
        """The name of the bag, or of the scenario without one."""
        if self.bag is None:
            return self.scenario.name
        return self.bag.stem if self.bag.is_file() else self.bag.resolve().name

    @property
    def scenario(self) -> Scenario:
        """The scenario as it was flown; without a verdict nobody knows who took which slot."""
        return self.recording.scenario if self.verdict is None else self.recording.flown

    @property
    def uavs(self) -> tuple[int, ...]:
        """UAVs whose odometry is recorded."""
        return tuple(uav for uav in self.scenario.uav_ids if uav in self.recording.odometry)

    def _instants(self) -> tuple[Track, int, int]:
        """The track whose stamps are the instants shown, and which of its samples they are."""
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
        """Number of instants shown."""
        _, begin, end = self._instants()
        return end - begin

    @property
    def window_ns(self) -> Window:
        """First and last instant shown: from just before the epoch as long as every UAV is recorded."""
        track, begin, end = self._instants()
        return track.rows(begin, begin + 1).first_ns, track.rows(end - 1, end).last_ns

    def grids(self) -> Iterator[NDArray[np.int64]]:
        """Instants shown, block by block."""
        track, begin, end = self._instants()
        for block in track.blocks(begin, end):
            yield block.t_ns

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return seconds(stamps, self.recording.start_ns)

    def seconds(self, window: Window) -> tuple[float, float]:
        """A window in seconds after the epoch."""
        begin, end = ((edge - self.recording.start_ns) * NANO for edge in window)
        return begin, end

    def avoiding(self, uav: int) -> list[Window]:
        """Spans in which a UAV was avoiding something."""
        return self._rising(uav, "avoidance_active_s")

    def deadlocks(self, uav: int) -> list[Window]:
        """Spans in which a UAV was in a deadlock."""
        return self._rising(uav, "deadlock_s")

    def _rising(self, uav: int, name: str) -> list[Window]:
        counters = self.recording.counters.get(uav)
        return [] if counters is None else merged(rising(counters, name))


def view_of(
    recording: Recording,
    status: StatusSeries,
    tolerance_m: float | None = None,
    bag: Path | None = None,
) -> FlightView:
    """Judge a recording, or say why that fails; the tolerance is that of the scenario by default."""
    limit_m = tolerance_of(recording, tolerance_m)
    try:
        verdict, problem = verdict_on(recording, limit_m), ""
    except PtnsbcError as error:
        verdict, problem = None, str(error)
    return FlightView(recording, status, limit_m, verdict, problem, bag)


def read_view(bag: Path, options: ReadOptions) -> FlightView:
    """Read a bag and judge it.

    Raises:
        PtnsbcError: no bag, cut, damaged, or without a scenario.
    """
    return view_of(read_recording(bag, options), read_status(bag), options.tolerance, bag)
