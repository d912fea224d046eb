"""What one UAV has heard, assembled into the inputs of one control step. No ROS in here.

Real time and lock-step differ in two numbers only: `now_ns`, and `cutoff_ns`, before which a
neighbour's message must be stamped to count. In lock-step the cutoff is the tick itself, so that a
message of tick k that overtakes the tick does not replace the one of k-1; in real time everything
that is here counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ptnsbc_core.types import (
    MODE_HOLD,
    NEAR_COLUMNS,
    NEVER_HEARD_S,
    ODOMETRY_SIZE,
    AgentInputs,
    Array,
)
from ptnsbc_nodes.turns import LEAD_TICKS
from ptnsbc_nodes.wire import Stamped
from ptnsbc_sim.chance.links import Losses

NO_CUTOFF_NS = 2**63 - 1
"""Cutoff of real time: every message counts, also that of a neighbour whose clock is ahead."""

_NOTHING = np.zeros(ODOMETRY_SIZE)
_NOTHING_NEAR = np.zeros((0, NEAR_COLUMNS))


_KEPT = LEAD_TICKS + 2  # in lock-step a sender is at most LEAD_TICKS ahead, and its k-1 is needed


class Link:
    """The last messages of one sender: its tick k may arrive before we have used its k-1."""

    __slots__ = ("_arrived_ns", "_messages")

    def __init__(self) -> None:
        self._messages: deque[Stamped] = deque(maxlen=_KEPT)  # the newest first
        self._arrived_ns: deque[int] = deque(maxlen=_KEPT)

    def put(self, message: Stamped, lost: bool = False) -> None:
        """Keep `message` as the newest; one sender's messages arrive in order.

        One that the scenario wants `lost` has still come: lock-step does not wait for it.
        """
        self._arrived_ns.appendleft(message.stamp_ns)
        if not lost:
            self._messages.appendleft(message)

    def arrived(self, stamp_ns: int) -> bool:
        """Whether the message of this stamp has come, lost or not."""
        return stamp_ns in self._arrived_ns

    def before(self, cutoff_ns: int) -> Stamped | None:
        """The newest message stamped before `cutoff_ns` [ns]."""
        for message in self._messages:
            if message.stamp_ns < cutoff_ns:
                return message
        return None


@dataclass(frozen=True)
class Senders:
    """Whom one UAV listens to: the tree edges that end at it, and no others."""

    parent: int | None
    leader: int | None  # None unless pinned
    estimators: tuple[int, ...]  # ascending: the order of the rows of AgentInputs.estimates
    losses: Losses | None = None  # which of their messages the scenario wants lost

    @property
    def states(self) -> tuple[int, ...]:
        """UAVs whose formation_state is needed; a child of the leader hears it once."""
        return tuple(sorted({i for i in (self.parent, self.leader) if i is not None}))


class Inbox:
    """Newest messages of everybody one UAV listens to."""

    def __init__(self, senders: Senders) -> None:
        self.senders = senders
        self.own: Stamped | None = None
        self.near: Stamped | None = None
        self._states = {i: Link() for i in senders.states}
        self._estimates = {i: Link() for i in senders.estimators}
        self._awaited = [*self._states.items(), *self._estimates.items()]

    def hear_state(self, uav_id: int, message: Stamped) -> None:
        """Keep a formation_state."""
        losses = self.senders.losses
        lost = losses is not None and losses.state(uav_id, message.stamp_ns)
        self._states[uav_id].put(message, lost)

    def hear_estimate(self, uav_id: int, message: Stamped) -> None:
        """Keep a leader_estimate."""
        losses = self.senders.losses
        lost = losses is not None and losses.estimate(uav_id, message.stamp_ns)
        self._estimates[uav_id].put(message, lost)

    def lose(self, uav_id: int) -> None:
        """Wait for this sender no longer: its process has ended. What it said ages from now on."""
        self._awaited = [(i, link) for i, link in self._awaited if i != uav_id]

    def holds_tick(self, period_ns: int, near_every: int) -> bool:
        """Whether everything that the tick of the own odometry needs is here (lock-step)."""
        if self.own is None or self.near is None:
            return False
        now_ns = self.own.stamp_ns
        tick = now_ns // period_ns
        if self.near.stamp_ns != (tick - tick % near_every) * period_ns:
            return False
        if tick == 0:
            return True
        return all(link.arrived(now_ns - period_ns) for _, link in self._awaited)

    def awaited(self, now_ns: int, period_ns: int) -> Iterable[int]:
        """Senders whose message of the tick before `now_ns` is missing; for diagnostics."""
        for i, link in self._awaited:
            if not link.arrived(now_ns - period_ns):
                yield i

    def held(self, cutoff_ns: int) -> list[Stamped | None]:
        """What `inputs` is made of: own, near, states, estimates, the latter two by ascending sender."""
        links = (*self._states.values(), *self._estimates.values())
        return [self.own, self.near, *(link.before(cutoff_ns) for link in links)]

    def inputs(
        self, now_ns: int, cutoff_ns: int, mode: int = MODE_HOLD, start_age_s: float = 0.0
    ) -> AgentInputs:
        """Inputs of the step at `now_ns`; the own odometry must have been heard."""
        if self.own is None:
            raise ValueError("inputs asked for before the own odometry: expected `own` to be set")
        parent, parent_age_s = self._state(self.senders.parent, now_ns, cutoff_ns)
        leader, leader_age_s = self._state(self.senders.leader, now_ns, cutoff_ns)
        estimates = np.zeros((len(self._estimates), ODOMETRY_SIZE))
        ages = np.full(len(self._estimates), NEVER_HEARD_S)
        for row, link in enumerate(self._estimates.values()):
            message = link.before(cutoff_ns)
            if message is not None:
                estimates[row] = message.values
                ages[row] = _age_s(message, now_ns)
        near = self.near
        return AgentInputs(
            own=self.own.values,
            parent=parent,
            parent_age_s=parent_age_s,
            leader=leader,
            leader_age_s=leader_age_s,
            estimates=estimates,
            estimate_age_s=ages,
            near=_NOTHING_NEAR if near is None else near.values,
            near_age_s=NEVER_HEARD_S if near is None else _age_s(near, now_ns),
            mode=mode,
            start_age_s=start_age_s,
        )

    def _state(self, uav_id: int | None, now_ns: int, cutoff_ns: int) -> tuple[Array, float]:
        message = None if uav_id is None else self._states[uav_id].before(cutoff_ns)
        if message is None:
            return _NOTHING, NEVER_HEARD_S
        return message.values, _age_s(message, now_ns)


def _age_s(message: Stamped, now_ns: int) -> float:
    # A neighbour's clock may be a little ahead; a message from the future is simply fresh.
    return max(now_ns - message.stamp_ns, 0) * 1e-9
