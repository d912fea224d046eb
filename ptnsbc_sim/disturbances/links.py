"""Messages between UAVs that get lost or come late. Loss is independent for every message, at the receiver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.disturbances.faults import FaultyLink, MessageFault, delays_ns, message_faults
from ptnsbc_sim.scenario import Scenario


@dataclass(frozen=True)
class MessageLoss:
    """The messages that one UAV does not receive. They follow from stamp and seed, so a re-run loses the same."""

    seed: int
    shares: Mapping[int, float]  # fraction that is lost, by sender
    receiver: int
    period_ns: int

    def state(self, sender: int, stamp_ns: int, faults: Sequence[MessageFault] = ()) -> bool:
        """True if the formation_state of this stamp is lost, by chance or by a fault."""
        return self._lost(random_streams.STATE_LINK, sender, stamp_ns, faults)

    def estimate(self, sender: int, stamp_ns: int, faults: Sequence[MessageFault] = ()) -> bool:
        """True if the leader_estimate of this stamp is lost, by chance or by a fault."""
        return self._lost(random_streams.ESTIMATE_LINK, sender, stamp_ns, faults)

    def _lost(self, kind: int, sender: int, stamp_ns: int, faults: Sequence[MessageFault]) -> bool:
        address = (self.seed, kind, self.receiver, sender)
        number = random_streams.uniform(address, max(stamp_ns, 0) // self.period_ns)
        if number < self.shares[sender]:
            return True
        link = FaultyLink(self.seed, kind, self.receiver, sender, self.period_ns)
        return bool(faults) and link.loses(faults, stamp_ns)


def message_loss(scenario: Scenario, uav_id: int) -> MessageLoss | None:
    """The message loss of one UAV; None when none of its links loses any, and no fault can be injected."""
    others = (i for i in scenario.uav_ids if i != uav_id)
    shares = {i: scenario.communication.link(i, uav_id).loss for i in others}
    if not any(shares.values()) and scenario.faults is None:
        return None
    return MessageLoss(scenario.seed, shares, uav_id, scenario.timing.dt_ns)


class LinkDelay(NamedTuple):
    """The delays of the messages of one sender."""

    ns: int
    ticks: int  # in control periods, rounded up


NO_DELAY = LinkDelay(0, 0)


def link_delay(scenario: Scenario, sender: int, receiver: int) -> LinkDelay:
    """The delay of one link."""
    delay_ns = nanoseconds(scenario.communication.link(sender, receiver).delay_s)
    return LinkDelay(delay_ns, -(-delay_ns // scenario.timing.dt_ns))


def _last_received(scenario: Scenario, kind: int, receiver: int, sender: int) -> NDArray[np.int64]:
    """Tick of the newest message (T,) received before each tick; -1: none.

    A message is at least one tick old, whatever the delay: at tick k everybody computes what it sends at k.
    """
    ticks = scenario.timing.ticks
    address = (scenario.seed, kind, receiver, sender)
    lost = random_streams.uniform_below(
        address, ticks, scenario.communication.link(sender, receiver).loss
    )
    faults = [fault for fault in message_faults(scenario) if fault.sender == sender]
    if faults:
        return _received_among_faults(scenario, kind, receiver, faults, lost)
    sent = np.maximum.accumulate(np.where(lost, -1, np.arange(ticks, dtype=np.int64)))
    late = min(max(link_delay(scenario, sender, receiver).ticks, 1), ticks)
    return np.concatenate((np.full(late, -1, dtype=np.int64), sent[: ticks - late]))


def _received_among_faults(
    scenario: Scenario,
    kind: int,
    receiver: int,
    faults: list[MessageFault],
    lost: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """As `_last_received`, with faults of one sender. A late message does not replace a newer one."""
    ticks, period_ns, sender = scenario.timing.ticks, scenario.timing.dt_ns, faults[0].sender
    link = FaultyLink(scenario.seed, kind, receiver, sender, period_ns)
    lost = lost | link.losses(faults, ticks)
    late_ns = link_delay(scenario, sender, receiver).ns + delays_ns(
        faults, sender, ticks, period_ns
    )
    sent = np.arange(ticks, dtype=np.int64)
    arrival = sent + np.maximum(-(-late_ns // period_ns), 1)
    newest = np.full(ticks, -1, dtype=np.int64)
    there = ~lost & (arrival < ticks)
    np.maximum.at(newest, arrival[there], sent[there])
    return np.maximum.accumulate(newest)


def last_state_received(scenario: Scenario, receiver: int, sender: int) -> NDArray[np.int64]:
    """Tick of the newest formation_state (T,) of one UAV that another has received before each tick; -1: none."""
    return _last_received(scenario, random_streams.STATE_LINK, receiver, sender)


def last_received(scenario: Scenario, width: int) -> NDArray[np.int64]:
    """Tick of the newest message (T, N, 2 + width + P) received before each tick; -1: none.

    Columns: from the parent, from the leader, from the neighbours in the estimator graph, and from each of several
    parents, where a UAV has some.
    """
    rows = [last_received_by(scenario, uav, width) for uav in scenario.uav_ids]
    return np.stack(rows, axis=1)


def last_received_by(scenario: Scenario, uav: int, width: int) -> NDArray[np.int64]:
    """The rows (T, 2 + width + P) of one UAV."""
    table = np.full(
        (scenario.timing.ticks, 2 + width + scenario.communication.most_parents), -1, dtype=np.int64
    )
    parent = scenario.communication.parent(uav)
    if parent is not None:
        table[:, 0] = _last_received(scenario, random_streams.STATE_LINK, uav, parent)
    if uav in scenario.topology.pinned:
        leader = scenario.leader.id
        table[:, 1] = _last_received(scenario, random_streams.STATE_LINK, uav, leader)
    for k, other in enumerate(scenario.topology.neighbours.get(uav, ())):
        table[:, 2 + k] = _last_received(scenario, random_streams.ESTIMATE_LINK, uav, other)
    for k, other in enumerate(scenario.communication.weights_of(uav)):
        received = _last_received(scenario, random_streams.STATE_LINK, uav, other)
        table[:, 2 + width + k] = received
    return table
