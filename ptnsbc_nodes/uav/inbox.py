"""The messages that one UAV has received, assembled into the inputs of one control step. No ROS in here.

Real time and lock-step differ in two numbers only: `now_ns`, and `cutoff_ns`, before which a
neighbour's message must be stamped to count. In lock-step the cutoff is the tick itself: a message of
tick k that arrives before the tick does not replace the message of k-1. In real time every message counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from ptnsbc_core.agent import (
    LEADER,
    LEADER_AGE,
    MODE,
    NEAR_AGE,
    OWN,
    PARENT,
    PARENT_AGE,
    START_AGE,
    PackedInputs,
)
from ptnsbc_core.behaviours.neighbour import mean_parent
from ptnsbc_core.kernel import prepared
from ptnsbc_core.kinematics import move_to_present
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import MODE_HOLD, NEAR_COLUMNS, NEVER_RECEIVED_S, ODOMETRY_SIZE, Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.graph import LEAD_TICKS, Senders
from ptnsbc_sim.disturbances.faults import MessageFault, message_fault
from ptnsbc_sim.disturbances.links import Link
from ptnsbc_sim.disturbances.random_streams import ESTIMATE_LINK, STATE_LINK
from ptnsbc_sim.plugins.uav_plugins import Heard
from ptnsbc_sim.scenario.mission.fault_rules import MOST_DELAY_S

NO_CUTOFF_NS = 2**63 - 1
"""Cutoff of real time: every message counts, also that of a neighbour whose clock is ahead."""

_NOTHING_NEAR = np.zeros((0, NEAR_COLUMNS))
# In lock-step a sender is at most LEAD_TICKS ahead, and its k-1 is needed.
_QUEUE_LENGTH = LEAD_TICKS + 2
_PERFECT = Link()


class MessageQueue:
    """The last messages of one sender: its tick k may arrive before its k-1 is used.

    A message that the scenario wants late has arrived, but it does not count before its time.
    """

    __slots__ = ("_faults", "_is_perfect", "_link", "_messages", "newest_ns")

    def __init__(self, link: Link = _PERFECT, faults: Sequence[MessageFault] | None = None) -> None:
        """`faults`: those of messages, which the first epoch brings; None where there will be none."""
        self._link, self._faults = link, () if faults is None else faults
        self._is_perfect = link.loss == 0.0 and link.delay_ns == 0  # of itself
        most_ns = link.delay_ns + (0 if faults is None else nanoseconds(MOST_DELAY_S))
        length = _QUEUE_LENGTH - (-most_ns // link.period_ns)
        self._messages: deque[Stamped] = deque(maxlen=length)  # the newest first
        self.newest_ns = -1  # stamp of the newest message, lost or not

    def put(self, message: Stamped) -> None:
        """Keep `message` as the newest; one sender's messages arrive in order.

        A message that the scenario wants lost has still arrived: lock-step does not wait for it.
        """
        stamp_ns = self.newest_ns = message.stamp_ns
        perfect = self._is_perfect and not self._faults
        if perfect or not self._link.loses(stamp_ns, self._faults):
            self._messages.appendleft(message)

    def miss(self, stamp_ns: int) -> None:
        """A message of this stamp has arrived and cannot be used: lock-step does not wait for it."""
        self.newest_ns = max(self.newest_ns, stamp_ns)

    def before(self, cutoff_ns: int, now_ns: int) -> Stamped | None:
        """The newest message stamped before `cutoff_ns` [ns] that has its delay behind it at `now_ns` [ns]."""
        perfect = self._is_perfect and not self._faults
        for message in self._messages:
            if message.stamp_ns >= cutoff_ns:
                continue
            if perfect:
                return message
            late_ns = self._link.late_ns(message.stamp_ns, self._faults)
            if late_ns == 0 or message.stamp_ns <= now_ns - late_ns:
                return message
        return None


class Inbox:
    """The newest messages of every sender that one UAV listens to."""

    def __init__(self, senders: Senders) -> None:
        self.senders = senders  # those whose messages are used
        self.own: Stamped | None = None  # odometry
        self.own_age_s = 0.0  # at the newest step
        self.near: Stamped | None = None
        self.used: list[Stamped | None] = []  # the `held` messages of the newest step
        self._begun = False
        self._faults: list[MessageFault] = []
        self._restarts: list[MessageFault] = []
        self._lost: set[int] = set()
        faults = self._faults if senders.faults else None

        def queue(kind: int, sender: int) -> MessageQueue:
            return MessageQueue(senders.links.get((kind, sender), _PERFECT), faults)

        # Of every sender that may be used, by UAV.
        self.state_queues = {i: queue(STATE_LINK, i) for i in senders.heard_states}
        self.estimate_queues = {i: queue(ESTIMATE_LINK, i) for i in senders.heard_estimators}
        self.listen_to(senders)

    def begin(self, t0_ns: int) -> None:
        """The first epoch is known, from which the times of injected faults count."""
        if self._begun:
            return
        self._begun = True
        for number, fault in enumerate(self.senders.faults):
            found = message_fault(fault, number, t0_ns)
            if found is not None:
                self._faults.append(found)
                if fault.kind == "restart":
                    self._restarts.append(found)

    def listen_to(self, senders: Senders) -> None:
        """Use the messages of these senders from now on; what has arrived of them counts."""
        self.senders = senders
        states = [(i, self.state_queues[i]) for i in senders.states]
        estimates = [(i, self.estimate_queues[i]) for i in senders.estimators]
        self._used = [*states, *estimates]
        self._places = {i: place for place, (i, _) in enumerate(states, 2)}  # of states in `used`
        self._inputs = PackedInputs(len(estimates), _NOTHING_NEAR)
        several, vector = senders.several, self._inputs.vector
        if several is not None:
            count = len(several.ids)
            self._parents = heard, ages = np.zeros((count, ODOMETRY_SIZE)), np.zeros(count)
            given = (several.weights, several.shifts, several.stale_s, vector[PARENT:LEADER])
            law = prepared(mean_parent, heard, ages, *given)
            self._mean_parent = partial(law, heard, ages, *given)
        self._own_row = vector[OWN:PARENT]
        self._move_to_present = prepared(move_to_present, self._own_row, 0.0)
        self._rows = tuple(self._rows_of_messages())
        self._await()

    def lose(self, uav_id: int) -> None:
        """Stop waiting for this sender, whose process has ended. Its last messages age from now on."""
        self._lost.add(uav_id)
        self._await()

    def _await(self) -> None:
        """Choose the senders that lock-step waits for: all where UAVs may come and go, because any may be used next."""
        every = [*self.state_queues.items(), *self.estimate_queues.items()]
        awaited = every if self.senders.every_tick else self._used
        self._awaited = [one for one in awaited if one[0] not in self._lost]

    def holds_tick(self, period_ns: int, near_every: int) -> bool:
        """True if everything that the tick of the own odometry needs is here (lock-step)."""
        if self.own is None or self.near is None:
            return False
        now_ns = self.own.stamp_ns
        if now_ns > 0:
            due_ns = now_ns - period_ns
            late = {uav_id for uav_id, queue in self._awaited if queue.newest_ns < due_ns}
            if late and late - {fault.sender for fault in self._restarts if fault.holds(due_ns)}:
                return False
        return self.near.stamp_ns == now_ns - now_ns % (period_ns * near_every)

    def held(self, now_ns: int, cutoff_ns: int) -> list[Stamped | None]:
        """The messages of a step: own, near, states, estimates, the latter two by ascending sender."""
        queues = [queue.before(cutoff_ns, now_ns) for _, queue in self._used]
        return [self.own, self.near, *queues]

    def states(self, now_ns: int, cutoff_ns: int) -> Iterator[Heard]:
        """The newest formation_state of every sender that has sent one, by ascending sender."""
        for uav_id in self.senders.states:
            message = self.state_queues[uav_id].before(cutoff_ns, now_ns)
            if message is not None:
                yield Heard(uav_id, message.values, _age_s(message, now_ns))

    def silent_estimates(self, now_ns: int, stale_ns: int) -> list[int]:
        """Real time: the senders of estimates whose newest one is older than `stale_ns` [ns]."""
        queues, used = self.estimate_queues, self.senders.estimators
        newest = ((i, queues[i].before(NO_CUTOFF_NS, now_ns)) for i in used)
        return [i for i, one in newest if one is not None and now_ns - one.stamp_ns > stale_ns]

    def topic_names(self, uav_id: int) -> list[str]:
        """The topics of the `held` messages of the UAV `uav_id`."""
        own = [topics.odom(uav_id), topics.near(uav_id)]
        states = [topics.formation_state(i) for i in self.senders.states]
        estimates = [topics.leader_estimate(i) for i in self.senders.estimators]
        return [topic.name for topic in (*own, *states, *estimates)]

    def pack_inputs(
        self, now_ns: int, cutoff_ns: int, mode: int = MODE_HOLD, start_age_s: float = 0.0
    ) -> PackedInputs:
        """The inputs of the step at `now_ns`, valid until the next call; the own odometry must have arrived."""
        if self.own is None:
            raise ValueError("inputs requested before the own odometry: expected `own` to be set")
        inputs = self._inputs
        vector = inputs.vector
        self._own_row[:] = self.own.values
        self.own_age_s = _age_s(self.own, now_ns)
        if self.own_age_s > 0.0:  # all others are extrapolated to the present too
            self._move_to_present(self._own_row, self.own_age_s)
        vector[MODE] = mode
        vector[START_AGE] = start_age_s
        if self.near is not None:
            if inputs.near is not self.near.values:
                inputs.near = self.near.values
            vector[NEAR_AGE] = _age_s(self.near, now_ns)
        used = self.used = self.held(now_ns, cutoff_ns)
        for place, row, age_at in self._rows:
            message = used[place]
            if message is not None:
                row[:] = message.values
                vector[age_at] = _age_s(message, now_ns)
        several = self.senders.several
        if several is not None:  # their messages as one
            states, ages = self._parents
            for k, uav_id in enumerate(several.ids):
                message = used[self._places[uav_id]]
                ages[k] = NEVER_RECEIVED_S if message is None else _age_s(message, now_ns)
                if message is not None:
                    states[k] = message.values
            vector[PARENT_AGE] = self._mean_parent()
        return inputs

    def _rows_of_messages(self) -> Iterator[tuple[int, Array, int]]:
        """Of each message in `used` the part (13,) of `PackedInputs.vector` for it, and the offset of its age."""
        inputs, senders = self._inputs, self.senders
        if senders.parent is not None and senders.several is None:
            yield self._places[senders.parent], inputs.vector[PARENT:LEADER], PARENT_AGE
        if senders.leader is not None:
            yield self._places[senders.leader], inputs.vector[LEADER:PARENT_AGE], LEADER_AGE
        first = 2 + len(senders.states)
        for k, row in enumerate(inputs.arrays.estimates):
            yield first + k, row, inputs.ages + k


def _age_s(message: Stamped, now_ns: int) -> float:
    # A neighbour's clock may be a little ahead: a message from the future is fresh.
    return seconds(max(now_ns - message.stamp_ns, 0))
