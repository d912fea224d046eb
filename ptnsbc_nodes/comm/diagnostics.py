"""The figures that nodes publish about themselves on /diagnostics: mostly cumulative counters."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ptnsbc_io.wire.cdr import split_stamp
from ptnsbc_io.wire.serialize import encode
from ptnsbc_sim.scenario import Scenario

STATUS_HZ = 5
INACTIVE = "activation"
"""In `waiting_for` of a node that is configured and not yet activated."""
_LOG_GAP_S = 1.0


def status_every(scenario: Scenario) -> int:
    """Number of ticks from one status to the next."""
    return max(scenario.timing.control_hz // STATUS_HZ, 1)


class DiagnosticLevel(IntEnum):
    """diagnostic_msgs/DiagnosticStatus levels."""

    OK = 0
    WARN = 1
    ERROR = 2


class StatusLog:
    """Logs a node's status when its level changes, at most once a second: on the console and on /rosout."""

    def __init__(self, node: Node, now_s: Callable[[], float] = time.monotonic) -> None:
        self._logger = node.get_logger()
        self._now_s = now_s
        self._level = DiagnosticLevel.OK
        self._logged_s = float("-inf")

    def note(self, level: DiagnosticLevel, message: str) -> None:
        """Take the newest status."""
        now_s = self._now_s()
        if level == self._level or now_s - self._logged_s < _LOG_GAP_S:
            return
        self._level, self._logged_s = level, now_s
        if level == DiagnosticLevel.OK:
            self._logger.info("all is well")
        elif level == DiagnosticLevel.WARN:
            self._logger.warning(message)
        else:
            self._logger.error(message)


def diagnostics(
    stamp_ns: int, name: str, level: DiagnosticLevel, message: str, values: Mapping[str, str]
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
    """The first values in the status of every node."""
    return {
        "ready": "false" if waiting_for else "true",
        "waiting_for": ", ".join(waiting_for),
    }
