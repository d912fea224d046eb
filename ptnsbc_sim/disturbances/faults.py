"""Injected faults as a flight feels them: messages that get lost or come late, positions that jump, UAVs that end."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS, FaultBlock

_GONE = ("kill", "restart")
_SILENCING = ("silence", "nan", *_GONE)  # a receiver refuses what is no number
_JUMP_COLUMNS = 6


class MessageFault(NamedTuple):
    """The effect of a fault on the messages of one UAV that are stamped within its time."""

    sender: int
    start_ns: int
    end_ns: int
    loss: float = 0.0  # fraction that is lost
    delay_ns: int = 0
    number: int = 0  # of the fault in the scenario: each has random numbers of its own

    def holds(self, stamp_ns: int) -> bool:
        """True if a message of this stamp [ns] is concerned."""
        return self.start_ns <= stamp_ns < self.end_ns

    def span(self, ticks: int, period_ns: int) -> slice:
        """Those of the first ticks whose messages are concerned."""
        first = min(-(-self.start_ns // period_ns), ticks)
        return slice(first, min(-(-self.end_ns // period_ns), ticks))


def message_fault(fault: FaultBlock, number: int, t0_ns: int) -> MessageFault | None:
    """A fault of messages whose mission begins at `t0_ns`; None for any other fault."""
    sender = fault.struck_uav
    if sender is None:
        return None
    start_ns, end_ns = fault.window_ns(t0_ns)
    if fault.kind in _SILENCING:
        return MessageFault(sender, start_ns, end_ns, loss=1.0, number=number)
    if fault.kind == "loss":
        return MessageFault(sender, start_ns, end_ns, loss=fault.share or 0.0, number=number)
    if fault.kind == "delay":
        late_ns = nanoseconds(fault.delay_s or 0.0)
        return MessageFault(sender, start_ns, end_ns, delay_ns=late_ns, number=number)
    return None


def message_faults(scenario: Scenario, t0_ns: int = 0) -> tuple[MessageFault, ...]:
    """The faults of messages of a scenario whose first epoch is `t0_ns`."""
    found = (message_fault(fault, k, t0_ns) for k, fault in enumerate(scenario.faults))
    return tuple(one for one in found if one is not None)


def without_position(values: Array) -> Array:
    """A state (13,) whose position is no number, as a UAV with the fault `nan` sends it."""
    broken = values.copy()
    broken[0:3] = np.nan
    return broken


def gone(scenario: Scenario, kinds: Collection[str] = _GONE) -> NDArray[np.bool_]:
    """True if the process of each UAV is dead at each tick (T, N), by faults of these kinds."""
    found = np.zeros((scenario.timing.ticks, len(scenario.uav_ids)), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.kind in kinds and fault.struck_uav is not None:
            row = scenario.uav_ids.index(fault.struck_uav)
            first, end = (-(-time_ns // scenario.timing.dt_ns) for time_ns in fault.window_ns(0))
            found[min(first, len(found)) : min(end, len(found)), row] = True
    return found


def jumps_of(scenario: Scenario) -> Array:
    """The jumps of measured positions (J, 6): row of the UAV, first tick, tick after the last, offset [m] ENU."""
    rows = []
    for fault in scenario.faults:
        if fault.kind == "jump" and fault.struck_uav is not None and fault.offset_m is not None:
            start_ns, end_ns = fault.window_ns(0)
            last_ns = min(end_ns, NEVER_NS)
            first, end = -(-start_ns // scenario.timing.dt_ns), -(-last_ns // scenario.timing.dt_ns)
            rows.append((scenario.uav_ids.index(fault.struck_uav), first, end, *fault.offset_m))
    return np.array(rows, dtype=np.float64).reshape(-1, _JUMP_COLUMNS)


@inline_kernel
def add_jumps(measured: Array, tick: int, row: int, jumps: Array) -> None:
    """Add to a measured odometry vector (13,) the jumps (J, 6) of UAV number `row` at `tick`, in place."""
    for k in range(jumps.shape[0]):
        if jumps[k, 0] == row and jumps[k, 1] <= tick < jumps[k, 2]:
            for i in range(3):
                measured[i] += jumps[k, 3 + i]
