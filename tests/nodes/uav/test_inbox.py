"""What counts as heard at a tick, in both clocks."""

from dataclasses import replace

import numpy as np
import pytest

from ptnsbc_core.types import MODE_HOLD, NEVER_RECEIVED_S, AgentInputs
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import LEAD_TICKS, Senders
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS, Inbox, MessageQueue
from ptnsbc_sim.disturbances.links import Link
from ptnsbc_sim.disturbances.random_streams import ESTIMATE_LINK, STATE_LINK

PERIOD = 10_000_000
NEAR_EVERY = 5
FOLLOWER = Senders(parent=2, leader=1, estimators=(2, 4))


def message(tick: int, value: float = 0.0, size: int = 13) -> Stamped:
    return Stamped(tick * PERIOD, np.full(size, value))


def near(tick: int) -> Stamped:
    return Stamped(tick * PERIOD, np.ones((2, 8)))


def link(delay_ns: int) -> Link:
    return Link(delay_ns=delay_ns, period_ns=PERIOD)


def hear_all(inbox: Inbox, tick: int) -> None:
    for i in inbox.senders.states:
        inbox.state_queues[i].put(message(tick, 10 * i + tick))
    for i in inbox.senders.estimators:
        inbox.estimate_queues[i].put(message(tick, 100 * i + tick))


def inputs_of(inbox: Inbox, *when) -> AgentInputs:
    return inbox.pack_inputs(*when).unpack()


def test_a_child_of_the_leader_hears_it_once():
    assert Senders(parent=1, leader=1, estimators=()).states == (1,)
    assert FOLLOWER.states == (1, 2)
    assert Senders(parent=None, leader=None, estimators=()).states == ()


def test_link_keeps_the_message_that_a_fast_neighbour_overtook():
    link = MessageQueue()
    assert link.before(NO_CUTOFF_NS, NO_CUTOFF_NS) is None
    link.put(message(6))
    link.put(message(7))
    assert link.before(7 * PERIOD, 7 * PERIOD).stamp_ns == 6 * PERIOD
    assert link.before(8 * PERIOD, 8 * PERIOD).stamp_ns == 7 * PERIOD
    assert link.before(6 * PERIOD, 6 * PERIOD) is None
    for tick in range(8, 6 + LEAD_TICKS + 2):  # as far ahead as lock-step lets it go
        link.put(message(tick))
    assert link.before(7 * PERIOD, 7 * PERIOD).stamp_ns == 6 * PERIOD
    assert link.before(NO_CUTOFF_NS, NO_CUTOFF_NS).stamp_ns == (6 + LEAD_TICKS + 1) * PERIOD


def test_inputs_before_anything_is_heard():
    inbox = Inbox(FOLLOWER)
    inbox.own = message(0, 1.0)
    inputs = inputs_of(inbox, 0, 0)
    assert inputs.parent_age_s == inputs.leader_age_s == inputs.near_age_s == NEVER_RECEIVED_S
    assert inputs.estimates.shape == (2, 13)
    assert (inputs.estimate_age_s == NEVER_RECEIVED_S).all()
    assert inputs.near.shape == (0, 8)
    assert inputs.mode == MODE_HOLD


def test_inputs_without_own_odometry_are_refused():
    with pytest.raises(ValueError, match="own odometry"):
        inputs_of(Inbox(FOLLOWER), 0, 0)


def test_lockstep_inputs_are_the_messages_of_the_tick_before():
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 6)
    hear_all(inbox, 7)  # overtook our tick 7
    inbox.own, inbox.near = message(7), near(5)
    now = 7 * PERIOD
    inputs = inputs_of(inbox, now, now, 0, 0.07)
    assert inputs.parent[0] == 26
    assert inputs.leader[0] == 16
    assert inputs.estimates[:, 0].tolist() == [206, 406]  # ascending ids
    assert inputs.parent_age_s == PERIOD * 1e-9
    assert inputs.near_age_s == 2 * PERIOD * 1e-9
    assert inputs.start_age_s == 0.07


def test_real_time_inputs_are_the_newest():
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 6)
    hear_all(inbox, 7)
    inbox.own = message(7)
    inputs = inputs_of(inbox, 8 * PERIOD, NO_CUTOFF_NS)
    assert inputs.parent[0] == 27
    assert inputs.parent_age_s == PERIOD * 1e-9


def test_the_own_odometry_is_moved_to_the_present():
    inbox = Inbox(FOLLOWER)
    values = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, -0.5, 0.0, 0.0, 0.0])
    inbox.own = Stamped(7 * PERIOD, values)
    np.testing.assert_array_equal(inputs_of(inbox, 7 * PERIOD, 7 * PERIOD).own, values)
    moved = inputs_of(inbox, 9 * PERIOD, NO_CUTOFF_NS).own
    np.testing.assert_allclose(moved[0:3], [1.01, 2.0, 2.99])
    np.testing.assert_array_equal(moved[3:], values[3:])
    assert inbox.own.values[0] == 1.0  # what the UAV sends is the message as it came


def test_a_neighbours_clock_ahead_of_ours_is_no_negative_age():
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 9)
    inbox.own = message(7)
    inputs = inputs_of(inbox, 8 * PERIOD, NO_CUTOFF_NS)
    assert inputs.parent_age_s == 0.0
    assert (inputs.estimate_age_s == 0.0).all()


def test_the_leader_needs_nobody():
    inbox = Inbox(Senders(None, None, ()))
    inbox.own, inbox.near = message(7), near(5)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)
    inputs = inputs_of(inbox, 7 * PERIOD, 7 * PERIOD)
    assert inputs.estimates.shape == (0, 13)
    assert not any(inputs.parent)


def test_tick_zero_needs_no_neighbours():
    inbox = Inbox(FOLLOWER)
    inbox.own = message(0)
    assert not inbox.holds_tick(PERIOD, NEAR_EVERY)
    inbox.near = near(0)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)


@pytest.mark.parametrize("missing", [("state", 1), ("state", 2), ("estimate", 2), ("estimate", 4)])
def test_a_tick_waits_for_each_message_of_the_tick_before(missing):
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 5)
    inbox.own, inbox.near = message(7), near(5)
    for i in (1, 2):
        if missing != ("state", i):
            inbox.state_queues[i].put(message(6))
    for i in (2, 4):
        if missing != ("estimate", i):
            inbox.estimate_queues[i].put(message(6))
    assert not inbox.holds_tick(PERIOD, NEAR_EVERY)
    kind, i = missing
    (inbox.state_queues if kind == "state" else inbox.estimate_queues)[i].put(message(6))
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)


def test_a_tick_waits_for_the_near_message_that_is_due():
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 9)
    inbox.own, inbox.near = message(10), near(5)
    assert not inbox.holds_tick(PERIOD, NEAR_EVERY)
    inbox.near = near(10)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)


def test_nobody_waits_for_the_lost_and_their_last_message_ages():
    inbox = Inbox(FOLLOWER)
    hear_all(inbox, 3)
    for tick in (5, 6):
        inbox.state_queues[1].put(message(tick))
        inbox.estimate_queues[4].put(message(tick))
    inbox.own, inbox.near = message(7), near(5)
    assert not inbox.holds_tick(PERIOD, NEAR_EVERY)
    inbox.lose(2)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)
    inputs = inputs_of(inbox, 7 * PERIOD, 7 * PERIOD)
    assert inputs.parent_age_s == pytest.approx(0.04)
    assert inputs.leader_age_s == pytest.approx(0.01)
    assert inputs.estimate_age_s == pytest.approx([0.04, 0.01])


def test_lost_messages_are_not_heard_and_not_waited_for():
    class Half(Link):
        def loses(self, stamp_ns, faults=()):
            return stamp_ns // PERIOD >= 4 if self.kind == STATE_LINK else self.sender == 4

    kinds = STATE_LINK, ESTIMATE_LINK
    links = {(kind, i): Half(i, 3, kind, loss=0.5) for kind in kinds for i in (1, 2, 4)}
    inbox = Inbox(replace(FOLLOWER, links=links))
    for tick in range(40):
        hear_all(inbox, tick)
    inbox.own, inbox.near = message(40), near(40)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)
    inputs = inputs_of(inbox, 40 * PERIOD, 40 * PERIOD)
    assert inputs.parent[0] == 20 + 3
    assert inputs.parent_age_s == inputs.leader_age_s == 37 * PERIOD * 1e-9
    np.testing.assert_array_equal(inputs.estimate_age_s, [PERIOD * 1e-9, NEVER_RECEIVED_S])


@pytest.mark.parametrize(
    ("delay_ns", "ticks"), [(1, 1), (PERIOD, 1), (PERIOD + 1, 2), (15 * PERIOD, 15)]
)
def test_late_messages_are_waited_for_and_count_later(delay_ns, ticks):
    late = {(STATE_LINK, 2), (ESTIMATE_LINK, 2)}
    inbox = Inbox(replace(FOLLOWER, links=dict.fromkeys(late, link(delay_ns))))
    for tick in range(40):
        hear_all(inbox, tick)
    for tick in range(40, 40 + LEAD_TICKS):  # these overtook our tick 40
        inbox.state_queues[2].put(message(tick, 20 + tick))
    inbox.own, inbox.near = message(40), near(40)
    assert inbox.holds_tick(PERIOD, NEAR_EVERY)
    inputs = inputs_of(inbox, 40 * PERIOD, 40 * PERIOD)
    assert inputs.parent[0] == 20 + 40 - ticks
    assert inputs.parent_age_s == ticks * PERIOD * 1e-9
    assert inputs.leader_age_s == PERIOD * 1e-9
    np.testing.assert_array_equal(inputs.estimate_age_s, [ticks * PERIOD * 1e-9, PERIOD * 1e-9])


def test_in_real_time_a_late_message_counts_to_the_nanosecond():
    every = [(kind, i) for kind in (STATE_LINK, ESTIMATE_LINK) for i in (1, 2, 4)]
    inbox = Inbox(replace(FOLLOWER, links=dict.fromkeys(every, link(25_000_000))))
    for tick in range(40):
        hear_all(inbox, tick)
    inbox.own = message(39)
    due_ns = 36 * PERIOD + 25_000_000
    for now_ns, tick in ((due_ns - 1, 35), (due_ns, 36)):
        assert inputs_of(inbox, now_ns, NO_CUTOFF_NS).parent[0] == 20 + tick
        assert inbox.held(now_ns, NO_CUTOFF_NS)[3].stamp_ns == tick * PERIOD


def test_the_senders_of_estimates_that_have_become_too_old_are_known():
    inbox = Inbox(FOLLOWER)
    inbox.estimate_queues[2].put(message(1))
    assert inbox.silent_estimates(3 * PERIOD, 2 * PERIOD) == []
    assert inbox.silent_estimates(4 * PERIOD, 2 * PERIOD) == [2]
    inbox.estimate_queues[2].put(message(4))
    assert inbox.silent_estimates(4 * PERIOD, 2 * PERIOD) == []
