"""What a verdict is computed from: plain arrays on one clock, wherever they were recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario

NANO = 1e-9
FORMATION = "form"  # leg with a deadline


class VerdictError(PtnsbcError):
    """A recording that cannot be judged."""


@dataclass(frozen=True)
class Series:
    """Samples of one quantity of one UAV."""

    t_ns: NDArray[np.int64]  # (T,) ascending
    values: Array  # (T, width)

    def at(self, t_ns: NDArray[np.int64]) -> Array:
        """Values at other times, linear in between; exact where the times coincide."""
        base = self.t_ns[0]  # wall-clock stamps do not fit a float64 to the nanosecond
        own = (self.t_ns - base).astype(np.float64)
        wanted = (t_ns - base).astype(np.float64)
        columns = [np.interp(wanted, own, column) for column in self.values.T]
        return np.stack(columns, axis=1)

    def last(self, t_ns: NDArray[np.int64]) -> Array:
        """The newest values at other times, the first ones before that: for counters."""
        index = np.searchsorted(self.t_ns, t_ns, side="right") - 1
        return self.values[np.maximum(index, 0)]


@dataclass(frozen=True)
class Counters:
    """Cumulative counters of one UAV from /diagnostics, all (T,)."""

    t_ns: NDArray[np.int64]
    avoidance_active_s: Array
    saturated_s: Array
    holding_s: Array
    missed_ticks: Array  # since the process started
    priority_violation_max: Array  # [m/s]

    def gained(self, name: str, start_ns: int, end_ns: int) -> float:
        """By how much a counter rose between two instants."""
        values: Array = getattr(self, name)
        before = int(np.searchsorted(self.t_ns, start_ns, side="left")) - 1
        after = int(np.searchsorted(self.t_ns, end_ns, side="right")) - 1
        first = float(values[before]) if before >= 0 else 0.0
        return max(float(values[after]) - first, 0.0) if after >= 0 else 0.0


@dataclass(frozen=True)
class Recording:
    """A whole flight, of the simulator, a fleet or real vehicles alike."""

    scenario: Scenario
    odometry: Mapping[int, Series]  # (T, 13) per UAV
    wrench: Mapping[int, Series]  # (T, 6) per UAV; may lack UAVs
    estimate: Mapping[int, Series]  # (T, 13) per UAV; may lack UAVs
    counters: Mapping[int, Counters]  # per UAV; may lack UAVs
    epochs: tuple[tuple[int, str], ...]  # (t0 [ns], leg), ascending; empty when not recorded
    truth: Mapping[int, Series] = field(default_factory=dict)  # (T, 13) per UAV, of simulators
    # (T, 1) per UAV: odometry messages sent until each stamp, as a bridge counts them
    sent: Mapping[int, Series] = field(default_factory=dict)
    latency: Mapping[str, float] = field(default_factory=dict)  # of the sim node, newest figures
    leg: int = 0  # which of the formation legs is looked at
    window_s: float | None = None  # look no further than this after its epoch

    @property
    def forms(self) -> tuple[int, ...]:
        """Epochs [ns] of the formation legs; the first message when none was recorded."""
        found = tuple(t0_ns for t0_ns, leg in self.epochs if leg == FORMATION)
        return found or (min(int(series.t_ns[0]) for series in self.odometry.values()),)

    @property
    def first_ns(self) -> int:
        """Epoch of the first formation leg: the leader's trajectory counts from here."""
        return self.forms[0]

    @property
    def start_ns(self) -> int:
        """Epoch of the leg: deadlines count from here."""
        return self.forms[self.leg]

    @property
    def due_ns(self) -> int:
        """When the leg should end: at the next epoch, or with the window or the flight."""
        return self._ended(self.first_ns + self.scenario.ticks * self.scenario.dt_ns)

    @property
    def end_ns(self) -> int:
        """When it is over: with the leg, or at the last instant that all UAVs recorded."""
        last = min(int(series.t_ns[-1]) for series in self.odometry.values())
        return self._ended(last)

    def _ended(self, last_ns: int) -> int:
        later = [t0_ns for t0_ns, _ in self.epochs if t0_ns > self.start_ns]
        if self.window_s is not None:
            later.append(self.start_ns + round(self.window_s / NANO))
        return min([last_ns, *later])

    def grid(self) -> NDArray[np.int64]:
        """The judged instants: the leader's stamps from the epoch to the end of the leg."""
        stamps = self.odometry[self.scenario.leader_id].t_ns
        inside = stamps[(stamps >= self.start_ns) & (stamps <= self.end_ns)]
        if inside.size < 2:
            raise VerdictError(
                "the recording holds no formation flight: expected odometry of the leader after "
                f"the epoch at {self.start_ns * NANO:.3f} s"
            )
        return inside

    def times(self, stamps: NDArray[np.int64]) -> Array:
        """Seconds (T,) after the epoch."""
        return np.asarray((stamps - self.start_ns) * NANO, dtype=np.float64)

    @property
    def judged_by(self) -> str:
        """What positions are taken from: `truth` where all UAVs have it, else `odometry`."""
        return "truth" if all(uav in self.truth for uav in self.scenario.uav_ids) else "odometry"

    def positions(self, grid: NDArray[np.int64]) -> dict[int, Array]:
        """Position (T, 3) [m], ENU, of every UAV on the grid."""
        source = self.truth if self.judged_by == "truth" else self.odometry
        return {uav: source[uav].at(grid)[:, :3] for uav in self.scenario.uav_ids}


def complete(recording: Recording) -> Recording:
    """`recording` when every UAV of its scenario is in it, an error otherwise."""
    missing = [uav for uav in recording.scenario.uav_ids if uav not in recording.odometry]
    if missing:
        names = ", ".join(f"/uav{uav}/odom" for uav in missing)
        raise VerdictError(f"no message on {names}: expected odometry of every UAV in the scenario")
    return recording
