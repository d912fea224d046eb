"""The faults of one UAV's process: those of its scenario, and those that an operator injects.

What becomes of the messages of others is the inbox's. No ROS in here.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from functools import partial

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.announcements import OrderedFault
from ptnsbc_nodes.uav.inbox import Inbox
from ptnsbc_sim.disturbances.faults import strikes, without_position
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import MESSAGES, FaultBlock

_MOST_INJECTED = 20  # that are remembered
_WINDOW_NS = 5_000_000_000  # an operator's clock that differs more is not believed


class UavFaults:
    """The faults that strike one UAV, in the stamps of its flight.

    In lock-step the process carries out its own `kill`: then the flight is the same every time. In real time the
    launcher kills.
    """

    def __init__(self, scenario: Scenario, uav_id: int, inbox: Inbox, lockstep: bool) -> None:
        """`inbox`: of the UAV; it takes the faults of the others."""
        self.allowed = scenario.faults is not None
        self.injected: list[str] = []  # in flight, in words
        self._uav, self._inbox, self._lockstep = uav_id, inbox, lockstep
        self._scenario = [fault for fault in (scenario.faults or ()) if fault.struck_uav == uav_id]
        self._count = len(scenario.faults or ())
        self._own: list[tuple[FaultBlock, int]] = []  # with the instant from which its time counts
        self._t0_ns: int | None = None

    def begin(self, t0_ns: int) -> None:
        """The first epoch is known."""
        if self._t0_ns is None:
            self._t0_ns = t0_ns
            self._inbox.begin(t0_ns)
            self._own += [(fault, t0_ns) for fault in self._scenario]

    def take(self, order: OrderedFault, now_ns: int) -> None:
        """A fault that an operator injects; in real time all UAVs count it from the same instant."""
        alike = not self._lockstep and abs(order.stamp_ns - now_ns) < _WINDOW_NS
        self.inject(order.fault, order.stamp_ns if alike else now_ns)

    def inject(self, fault: FaultBlock, now_ns: int) -> None:
        """A fault that begins now."""
        if self._lockstep and fault.rule.strikes == MESSAGES:
            return  # receivers would begin it at different ticks
        flight_s = 0.0 if self._t0_ns is None else seconds(now_ns - self._t0_ns)
        self.injected.append(fault.model_copy(update={"at_s": round(flight_s, 1)}).text)
        del self.injected[:-_MOST_INJECTED]
        fault = fault.model_copy(update={"at_s": 0.0})
        self._inbox.inject(fault, self._count, now_ns)
        self._count += 1
        if fault.struck_uav == self._uav:
            self._own.append((fault, now_ns))

    def strike(self, now_ns: int) -> None:
        """Lock-step: end this process when its time has come."""
        if self._lockstep and any(
            strikes(fault, "kill", self._uav, now_ns, t0_ns) for fault, t0_ns in self._own
        ):
            os.kill(os.getpid(), signal.SIGKILL)

    def plays_dead(self, now_ns: int) -> bool:
        """Lock-step: whether a restart has this process silent; none can be started at a tick, so it plays that."""
        return self._lockstep and any(
            strikes(fault, "restart", self._uav, now_ns, t0_ns) for fault, t0_ns in self._own
        )

    def sent(self, message: Stamped) -> Stamped:
        """A state (13,) of this UAV as its neighbours get it."""
        return _sent(self._own, self._uav, message) if self._own else message


def sent_faults(
    scenario: Scenario, uav_id: int, t0_ns: int = 0
) -> Callable[[Stamped], Stamped] | None:
    """The faults of a scenario in the states of one UAV; None without any."""
    own = [(fault, t0_ns) for fault in (scenario.faults or ()) if fault.struck_uav == uav_id]
    return partial(_sent, own, uav_id) if own else None


def _sent(own: Sequence[tuple[FaultBlock, int]], uav_id: int, message: Stamped) -> Stamped:
    stamp_ns, values = message
    for fault, t0_ns in own:
        if strikes(fault, "nan", uav_id, message.stamp_ns, t0_ns):
            values = without_position(values)
        elif strikes(fault, "clock_offset", uav_id, message.stamp_ns, t0_ns):
            stamp_ns += nanoseconds(fault.offset_s or 0.0)
    return Stamped(stamp_ns, values)
