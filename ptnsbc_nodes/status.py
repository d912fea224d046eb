"""What the nodes tell about themselves on /diagnostics: cumulative counters, mostly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ptnsbc_core.types import AgentDiagnostics
from ptnsbc_nodes.plain import encode
from ptnsbc_nodes.wire.cdr import split_stamp

STATUS_HZ = 5


class Level(IntEnum):
    """diagnostic_msgs/DiagnosticStatus levels."""

    OK = 0
    WARN = 1
    ERROR = 2


def diagnostics(
    stamp_ns: int, name: str, level: Level, message: str, values: Mapping[str, str]
) -> bytes:
    """A DiagnosticArray with one status, serialised; `name` is like `uav3: planner`."""
    status = DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=message,
        hardware_id=name.partition(":")[0],
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp.sec, array.header.stamp.nanosec = split_stamp(stamp_ns)
    return encode(array)


def readiness(waiting_for: Sequence[str]) -> dict[str, str]:
    """The values every node starts its status with."""
    return {
        "ready": "false" if waiting_for else "true",
        "waiting_for": " ".join(waiting_for),
    }


class Tally:
    """Cumulative counters of one UAV since its start, and the newest figures of its planner."""

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
