"""Messages between UAVs that get lost or come late. Loss is independent for every message, at the receiver.

Sender and receiver need not agree on anything: what becomes of a message follows from its stamp, the seed and the
faults. A headless flight takes whole tables, a process asks for one message at a time; both get the same answers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_sim.disturbances.faults import MessageFault, message_faults
from ptnsbc_sim.disturbances.random_streams import (
    ESTIMATE_LINK,
    FAULT,
    STATE_LINK,
    Address,
    first_numbers,
    uniform,
)
from ptnsbc_sim.scenario import Scenario


class Link(NamedTuple):
    """One kind of message on its way from one UAV to another; `faults` may be of any sender."""

    sender: int = 0
    receiver: int = 0
    kind: int = STATE_LINK  # or ESTIMATE_LINK
    seed: int = 0
    loss: float = 0.0  # fraction that is lost
    delay_ns: int = 0
    period_ns: int = 1

    def loses(self, stamp_ns: int, faults: Iterable[MessageFault] = ()) -> bool:
        """True if the message of this stamp is lost, by chance or by a fault."""
        tick = max(stamp_ns, 0) // self.period_ns
        if self.loss > 0.0 and uniform(self._address(), tick) < self.loss:
            return True
        return any(
            fault.sender == self.sender
            and fault.holds(stamp_ns)
            and (fault.loss >= 1.0 or uniform(self._address(fault), tick) < fault.loss)
            for fault in faults
        )

    def losses(self, ticks: int, faults: Iterable[MessageFault] = ()) -> NDArray[np.bool_]:
        """The same for the message of each tick (ticks,)."""
        lost = np.asarray(first_numbers(self._address(), ticks) < self.loss)
        for fault in faults:
            if fault.sender == self.sender and fault.loss > 0.0:
                span = fault.span(ticks, self.period_ns)
                lost[span] |= (first_numbers(self._address(fault), ticks) < fault.loss)[span]
        return lost

    def late_ns(self, stamp_ns: int, faults: Iterable[MessageFault] = ()) -> int:
        """The delay [ns] of the message of this stamp, with what faults add to it."""
        mine = (fault for fault in faults if fault.sender == self.sender)
        return self.delay_ns + sum(fault.delay_ns for fault in mine if fault.holds(stamp_ns))

    def delays_ns(self, ticks: int, faults: Iterable[MessageFault] = ()) -> NDArray[np.int64]:
        """The same for the message of each tick (ticks,)."""
        late_ns = np.full(ticks, self.delay_ns, dtype=np.int64)
        for fault in faults:
            if fault.sender == self.sender:
                late_ns[fault.span(ticks, self.period_ns)] += fault.delay_ns
        return late_ns

    def newest(self, ticks: int, faults: Iterable[MessageFault] = ()) -> NDArray[np.int64]:
        """Tick of the newest message (ticks,) received before each tick; -1: none.

        A message is at least one tick old, whatever the delay: at tick k everybody computes what it sends at k. A late
        one does not replace a newer one.
        """
        sent = np.arange(ticks, dtype=np.int64)
        arrival = sent + np.maximum(-(-self.delays_ns(ticks, faults) // self.period_ns), 1)
        there = ~self.losses(ticks, faults) & (arrival < ticks)
        newest = np.full(ticks, -1, dtype=np.int64)
        np.maximum.at(newest, arrival[there], sent[there])
        return np.maximum.accumulate(newest)

    def _address(self, fault: MessageFault | None = None) -> Address:
        """Of the random numbers of the link, or of a fault on it."""
        of_fault = () if fault is None else (FAULT, fault.number)
        return (self.seed, *of_fault, self.kind, self.receiver, self.sender)


def link_of(scenario: Scenario, kind: int, receiver: int, sender: int) -> Link:
    """The link of a scenario from one UAV to another, for one kind of message."""
    loss, delay_s = scenario.communication.link(sender, receiver)
    period_ns = scenario.timing.dt_ns
    return Link(sender, receiver, kind, scenario.seed, loss, nanoseconds(delay_s), period_ns)


def _newest(scenario: Scenario, kind: int, receiver: int, sender: int) -> NDArray[np.int64]:
    link = link_of(scenario, kind, receiver, sender)
    return link.newest(scenario.timing.ticks, message_faults(scenario))


def last_state_received(scenario: Scenario, receiver: int, sender: int) -> NDArray[np.int64]:
    """Tick of the newest formation_state (T,) of one UAV that another has received before each tick; -1: none."""
    return _newest(scenario, STATE_LINK, receiver, sender)


def last_received(scenario: Scenario, width: int) -> NDArray[np.int64]:
    """Tick of the newest message (T, N, 2 + width + P) received before each tick; -1: none.

    Columns: from the parent, from the leader, from the neighbours in the estimator graph, and from each of several
    parents, where a UAV has some.
    """
    rows = [last_received_by(scenario, uav, width) for uav in scenario.uav_ids]
    return np.stack(rows, axis=1)


def last_received_by(scenario: Scenario, uav: int, width: int) -> NDArray[np.int64]:
    """The rows (T, 2 + width + P) of one UAV."""
    parents = max(map(len, (scenario.communication.parents or {}).values()), default=0)
    table = np.full((scenario.timing.ticks, 2 + width + parents), -1, dtype=np.int64)
    parent = scenario.communication.parent(uav)
    if parent is not None:
        table[:, 0] = _newest(scenario, STATE_LINK, uav, parent)
    if uav in scenario.topology.pinned:
        leader = scenario.leader.id
        table[:, 1] = _newest(scenario, STATE_LINK, uav, leader)
    for k, other in enumerate(scenario.topology.neighbours.get(uav, ())):
        table[:, 2 + k] = _newest(scenario, ESTIMATE_LINK, uav, other)
    for k, other in enumerate(scenario.communication.weights_of(uav)):
        table[:, 2 + width + k] = _newest(scenario, STATE_LINK, uav, other)
    return table
