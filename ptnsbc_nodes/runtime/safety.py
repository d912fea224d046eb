"""The safety state of a UAV process or a bridge: one vocabulary for what it still does, and why.

Each process says what concerns it, several things at once perhaps; the worst of them is its state. The state is on
/diagnostics under `safety`, and the reasons are the message there, so that a bag has both.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel

SAFETY = "safety"
"""Key of the state on /diagnostics."""


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
