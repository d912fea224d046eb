"""Status that nodes publish of themselves on /diagnostics: mostly cumulative counters, and their safety state.

The safety state says what a UAV process or a bridge still does, and why. Each says what concerns it, several things at
once perhaps; the worst of them is its state. The state is under the key `safety`, and the reasons are the message, so
that a bag has both.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from rclpy.node import Node

from ptnsbc_io.cdr import LITTLE_ENDIAN_HEADER, aligned_string, encode_string, stamp_bytes
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints

SAFETY = "safety"
"""Key of the safety state."""
_LOG_GAP_S = 1.0
_STATUS_HEAD = struct.Struct("<I4xIB3x")  # of an empty frame_id, for one status, with its level


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
    """A DiagnosticArray with one status, serialised; `name` is like `uav3: planner`.

    rclpy's objects of a status with twenty values cost more than a control step.
    """
    texts = [text for pair in values.items() for text in pair]
    about = b"".join(map(aligned_string, (name, message, name.partition(":")[0])))
    # Nothing is aligned behind the last text.
    pairs = b"".join((*map(aligned_string, texts[:-1]), *map(encode_string, texts[-1:])))
    head = LITTLE_ENDIAN_HEADER + stamp_bytes(stamp_ns) + _STATUS_HEAD.pack(1, 1, level)
    return head + about + len(values).to_bytes(4, "little") + pairs


class StatusPublisher:
    """The status of one process: on /diagnostics, and in lock-step before and between ticks on /formation/ready."""

    def __init__(self, node: Node, endpoints: Endpoints, name: str, recorders: int) -> None:
        """`name`: of the status, like `uav3: planner`; `recorders`: that must hear it before the flight."""
        self._send = endpoints.publisher(topics.DIAGNOSTICS, recorders)
        self.send_ready = endpoints.publisher(topics.READY, 0)
        self._log = StatusLog(node)
        self._name = name

    def publish(
        self, stamp_ns: int, level: DiagnosticLevel, message: str, values: Mapping[str, str]
    ) -> None:
        """Publish and log the status at an instant of the flight; -1 is outside of it."""
        self._log.note(level, message)
        send = self._send if stamp_ns >= 0 else self.send_ready
        send(diagnostics(max(stamp_ns, 0), self._name, level, message, values))


def readiness(waiting_for: Sequence[str]) -> dict[str, str]:
    """The first values in the status of every node."""
    return {"ready": "false" if waiting_for else "true", "waiting_for": ", ".join(waiting_for)}


class SafetyState(IntEnum):
    """The state of the safety layer of a UAV process or a bridge, from full control to none."""

    NOMINAL = 0  # what the mission wants
    DEGRADED = 1  # the same with less: a sensor, a neighbour or ticks are missing
    HOLD_CLEAR = 2  # it holds where it is and keeps clear of others
    LAND = 3  # it lands
    STOP = 4  # it sends no setpoint: its vehicle is left to its own failsafe or to a pilot, or its motors stop

    @property
    def text(self) -> str:
        """Like `hold clear`."""
        return self.name.lower().replace("_", " ")


class Concern(NamedTuple):
    """Something that a process has noticed, and the state that it asks for."""

    state: SafetyState
    level: DiagnosticLevel
    reason: str


def assess(concerns: Iterable[Concern]) -> Concern:
    """All concerns as one: the worst state, the highest level, the reasons with the worst first."""
    found = sorted(concerns, key=lambda one: -one.state)
    if not found:
        return Concern(SafetyState.NOMINAL, DiagnosticLevel.OK, "")
    level = max(one.level for one in found)
    return Concern(found[0].state, level, "; ".join(one.reason for one in found))
