"""Counters of one UAV's control steps, as /diagnostics tells them. No ROS in here: a re-run counts too."""

from __future__ import annotations

from typing import Any

from ptnsbc_core.types import AgentDiagnostics, Array


class UavCounters:
    """Cumulative counters of one UAV since its start, and the newest figures of its planner."""

    SIZE = 5  # numbers in `counters`

    def __init__(self) -> None:
        self.ticks = 0
        self.avoidance_active_s = 0.0
        self.saturated_s = 0.0
        self.holding_s = 0.0
        self.priority_violation_max = 0.0  # [m/s]
        self._newest: AgentDiagnostics | None = None

    def add(self, step: AgentDiagnostics, dt: float) -> None:
        """Count one step that lasted `dt` [s]."""
        self.ticks += 1
        self.avoidance_active_s += dt * (step.active_rows > 0)
        self.saturated_s += dt * step.saturated
        self.holding_s += dt * step.holding
        self.priority_violation_max = max(self.priority_violation_max, step.priority_violation)
        self._newest = step

    @property
    def holding(self) -> bool:
        """Whether the UAV held its position at the newest step."""
        return self._newest is not None and bool(self._newest.holding)

    def counters(self) -> list[float]:
        """The counters alone, as numbers."""
        return [
            float(self.ticks),
            self.avoidance_active_s,
            self.saturated_s,
            self.holding_s,
            self.priority_violation_max,
        ]

    def restore(self, counters: Array) -> None:
        """Go on from what `counters` gave."""
        self.ticks = int(counters[0])
        self.avoidance_active_s, self.saturated_s, self.holding_s, self.priority_violation_max = (
            float(value) for value in counters[1:]
        )

    def values(self) -> dict[str, str]:
        """The counters as key-value strings."""
        newest: Any = self._newest
        error = newest.error if newest else (0.0, 0.0, 0.0)
        return {
            "avoidance_active_s": f"{self.avoidance_active_s:.3f}",
            "saturated_s": f"{self.saturated_s:.3f}",
            "holding_s": f"{self.holding_s:.3f}",
            "ticks": str(self.ticks),
            "formation_error": f"{sum(float(e) ** 2 for e in error) ** 0.5:.6f}",
            "gain": f"{newest.gain if newest else 0.0:.6f}",
            "sigma_min": f"{newest.singular_value if newest else 0.0:.6f}",
            "priority_violation_max": f"{self.priority_violation_max:.6g}",
        }
