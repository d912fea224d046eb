"""The counters that a UAV publishes on /diagnostics: one table for processes, headless flights and verdicts."""

from __future__ import annotations

import numpy as np

from ptnsbc_core import agent as columns
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import AgentDiagnostics, Array
from ptnsbc_sim.scenario import Scenario

STATUS_HZ = 5
"""Rate at which nodes publish their status."""

_COUNTED = {
    "avoidance_active_s": ("active_rows", columns.ACTIVE_ROWS),
    "saturated_s": ("saturated", columns.SATURATED),
    "holding_s": ("holding", columns.HOLDING),
    "deadlock_s": ("deadlock", columns.DEADLOCK),
}
"""Counters of a time, and the field and the column of the diagnostics that are above 0 during it."""

COUNTERS = (
    "avoidance_active_s",
    "saturated_s",
    "holding_s",
    "missed_ticks",  # since the process started
    "priority_violation_max",  # [m/s]
    "deadlock_s",
)
"""Columns of the counters in a recording, counted from the start of the process."""


_CUMULATIVE = ("ticks", *(name for name in COUNTERS if name != "missed_ticks"))


def status_every(scenario: Scenario) -> int:
    """Number of ticks from one status to the next."""
    return max(scenario.timing.control_hz // STATUS_HZ, 1)


class UavCounters:
    """Cumulative counters of one UAV since its start, and the newest figures of its planner."""

    SIZE = len(_CUMULATIVE)  # numbers in `numbers`

    def __init__(self) -> None:
        self._counted = dict.fromkeys(_CUMULATIVE, 0.0)
        self._newest = AgentDiagnostics((0.0, 0.0, 0.0), 0.0, 0.0, 0, False, False, 0.0, 0.0, False)

    def add(self, step: AgentDiagnostics, dt: float) -> None:
        """Count one step that lasted `dt` [s]."""
        counted = self._counted
        counted["ticks"] += 1.0
        for name, (field, _) in _COUNTED.items():
            counted[name] += dt * (getattr(step, field) > 0)
        worst = "priority_violation_max"  # [m/s]
        counted[worst] = max(counted[worst], step.priority_violation)
        self._newest = step

    @property
    def ticks(self) -> int:
        """Number of steps."""
        return int(self._counted["ticks"])

    @property
    def deadlock(self) -> bool:
        """True if the UAV was in a deadlock at the newest step."""
        return bool(self._newest.deadlock)

    @property
    def holding(self) -> bool:
        """True if the UAV held its position at the newest step."""
        return bool(self._newest.holding)

    def numbers(self) -> list[float]:
        """The cumulative counters as numbers, as a snapshot of the controller has them."""
        return list(self._counted.values())

    def restore(self, numbers: Array) -> None:
        """Continue from what `numbers` returned."""
        self._counted = dict(zip(_CUMULATIVE, numbers.tolist(), strict=True))

    def values(self) -> dict[str, str]:
        """Counters and newest figures as key-value strings; `deadlock_s` from the first deadlock on."""
        newest, counted = self._newest, self._counted
        times = {name: f"{counted[name]:.3f}" for name in _COUNTED if name != "deadlock_s"}
        deadlock_s = counted["deadlock_s"]
        return {
            **times,
            "ticks": str(self.ticks),
            "formation_error": f"{sum(float(e) ** 2 for e in newest.error) ** 0.5:.6f}",
            "gain": f"{newest.gain:.6f}",
            "sigma_min": f"{newest.singular_value:.6f}",
            "priority_violation_max": f"{counted['priority_violation_max']:.6g}",
            **({"deadlock_s": f"{deadlock_s:.3f}"} if deadlock_s > 0.0 else {}),
        }


def counters_of(diagnostics: Array, scenario: Scenario) -> Array:
    """Counters (S, N, 6) of a headless flight at every status, rounded to milliseconds as on /diagnostics.

    Args:
        diagnostics: (T, N, 11) of its track.
        scenario: as flown.
    """
    every = status_every(scenario)
    first = np.maximum(np.arange(1 - every, len(diagnostics) + 1 - every, every), 0)  # new ticks
    told = diagnostics[: (len(first) - 1) * every + 1]
    active = told[:, :, [column for _, column in _COUNTED.values()]] > 0
    ticks = np.add.reduceat(active, first, axis=0, dtype=np.int64).cumsum(axis=0)
    worst = np.maximum.reduceat(told[:, :, columns.PRIORITY_VIOLATION], first, axis=0)
    values = np.zeros((*worst.shape, len(COUNTERS)))
    times = np.round(ticks * seconds(scenario.timing.dt_ns), 3)
    values[:, :, [COUNTERS.index(name) for name in _COUNTED]] = times
    values[:, :, COUNTERS.index("priority_violation_max")] = np.maximum.accumulate(worst)
    return values
