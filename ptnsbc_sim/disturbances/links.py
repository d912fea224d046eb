"""Messages between UAVs that get lost or come late. Loss is independent for every message, at the receiver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.scenario import Scenario


@dataclass(frozen=True)
class MessageLoss:
    """The messages that one UAV does not receive. They follow from stamp and seed, so a re-run loses the same."""

    seed: int
    shares: Mapping[int, float]  # fraction that is lost, by sender
    receiver: int
    period_ns: int

    def state(self, sender: int, stamp_ns: int) -> bool:
        """Whether the formation_state of this stamp is lost."""
        return self._lost(random_streams.STATE_LINK, sender, stamp_ns)

    def estimate(self, sender: int, stamp_ns: int) -> bool:
        """Whether the leader_estimate of this stamp is lost."""
        return self._lost(random_streams.ESTIMATE_LINK, sender, stamp_ns)

    def _lost(self, kind: int, sender: int, stamp_ns: int) -> bool:
        address = (self.seed, kind, self.receiver, sender)
        number = random_streams.uniform(address, max(stamp_ns, 0) // self.period_ns)
        return number < self.shares[sender]


def message_loss(scenario: Scenario, uav_id: int) -> MessageLoss | None:
    """The message loss of one UAV; None when none of its links loses any."""
    others = (i for i in scenario.uav_ids if i != uav_id)
    shares = {i: scenario.link(i, uav_id).loss for i in others}
    if not any(shares.values()):
        return None
    return MessageLoss(scenario.seed, shares, uav_id, scenario.dt_ns)


class LinkDelay(NamedTuple):
    """How late the messages of one sender come."""

    ns: int
    ticks: int  # in control periods, rounded up


NO_DELAY = LinkDelay(0, 0)


def link_delay(scenario: Scenario, sender: int, receiver: int) -> LinkDelay:
    """The delay of one link."""
    delay_ns = round(scenario.link(sender, receiver).delay_s * 1e9)
    return LinkDelay(delay_ns, -(-delay_ns // scenario.dt_ns))


def _last_received(scenario: Scenario, kind: int, receiver: int, sender: int) -> NDArray[np.int64]:
    """Tick of the newest message (T,) received before each tick; -1: none.

    A message is at least one tick old, whatever the delay: at tick k everybody computes what it sends at k.
    """
    ticks = scenario.ticks
    address = (scenario.seed, kind, receiver, sender)
    lost = random_streams.uniform_below(address, ticks, scenario.link(sender, receiver).loss)
    sent = np.maximum.accumulate(np.where(lost, -1, np.arange(ticks, dtype=np.int64)))
    late = min(max(link_delay(scenario, sender, receiver).ticks, 1), ticks)
    return np.concatenate((np.full(late, -1, dtype=np.int64), sent[: ticks - late]))


def last_state_received(scenario: Scenario, receiver: int, sender: int) -> NDArray[np.int64]:
    """Tick of the newest formation_state (T,) of one UAV that another has received before each tick; -1: none."""
    return _last_received(scenario, random_streams.STATE_LINK, receiver, sender)


def last_received(scenario: Scenario, width: int) -> NDArray[np.int64]:
    """Tick of the newest message (T, N, 2 + width) received before each tick; -1: none.

    Columns: from the parent, from the leader, from the neighbours in the estimator graph.
    """
    ids = scenario.uav_ids
    table = np.full((scenario.ticks, len(ids), 2 + width), -1, dtype=np.int64)
    for row, uav in enumerate(ids):
        parent = scenario.parent(uav)
        if parent is not None:
            table[:, row, 0] = _last_received(scenario, random_streams.STATE_LINK, uav, parent)
        if scenario.pinned(uav):
            leader = scenario.leader_id
            table[:, row, 1] = _last_received(scenario, random_streams.STATE_LINK, uav, leader)
        for k, other in enumerate(scenario.estimator_neighbours(uav)):
            table[:, row, 2 + k] = _last_received(
                scenario, random_streams.ESTIMATE_LINK, uav, other
            )
    return table
