"""The faults of one UAV's process."""

import os

import numpy as np
import pytest

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.uav.inbox import Inbox
from ptnsbc_nodes.uav.uav_faults import UavFaults, sent_faults
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.mission.fault_rules import FaultBlock

EPOCH_NS = 5_000_000_000
MANY = [
    {"kind": "silence", "uav": 2, "at_s": 0.5, "duration_s": 0.3},
    {"kind": "loss", "uav": 2, "at_s": 1.0, "duration_s": 1.0, "share": 0.4},
    {"kind": "delay", "uav": 2, "at_s": 1.2, "duration_s": 0.6, "delay_s": 0.2},
]


def faults_of(uav, faults, *, lockstep=False):
    scenario = load_scenario("paper_5", {"faults": faults, "timing.duration_s": 2.5})
    inbox = Inbox(CommunicationGraph(scenario, FlightOptions()).senders(uav))
    return UavFaults(scenario, uav, inbox, lockstep), inbox


@pytest.fixture
def killed(monkeypatch):
    """The processes that a UAV has ended."""
    pids = []
    monkeypatch.setattr(os, "kill", lambda pid, _signal: pids.append(pid))
    return pids


def state(stamp_ns: int) -> Stamped:
    return Stamped(stamp_ns, np.ones(13))


def test_a_process_receives_what_the_headless_flight_receives():
    """In lock-step the two must not differ by one message."""
    faults, inbox = faults_of(3, MANY, lockstep=True)
    scenario = load_scenario("paper_5", {"faults": MANY, "timing.duration_s": 2.5})
    faults.begin(0)
    expected, dt_ns = last_state_received(scenario, 3, 2), scenario.timing.dt_ns
    for tick in range(scenario.timing.ticks):
        inbox.on_state(2, state(tick * dt_ns))
        heard = inbox.state_queues[2].before(tick * dt_ns, tick * dt_ns)
        assert (-1 if heard is None else heard.stamp_ns // dt_ns) == expected[tick], tick


def test_faults_count_from_the_first_epoch_and_only_once():
    faults, inbox = faults_of(3, [{"kind": "silence", "uav": 2, "at_s": 1}])
    before, after = EPOCH_NS + 990_000_000, EPOCH_NS + 1_010_000_000
    inbox.on_state(2, state(2_000_000_000))  # before the epoch nothing is struck
    faults.begin(EPOCH_NS)
    faults.begin(EPOCH_NS - 1_000_000_000)  # another leg
    inbox.on_state(2, state(before))
    inbox.on_state(2, state(after))
    assert inbox.state_queues[2].before(2**62, 2**62).stamp_ns == before
    assert inbox.state_queues[2].newest_ns == after


def test_in_lockstep_a_uav_ends_itself_at_its_tick(killed):
    faults, _ = faults_of(2, [{"kind": "kill", "uav": 2, "at_s": 1}], lockstep=True)
    faults.begin(0)
    faults.strike(990_000_000)
    assert killed == []
    faults.strike(1_000_000_000)
    assert killed == [os.getpid()]


@pytest.mark.parametrize(("uav", "lockstep"), [(2, False), (3, True)])
def test_in_real_time_the_launcher_kills_and_nobody_ends_for_another(killed, uav, lockstep):
    fault = [{"kind": "kill", "uav": 2, "at_s": 1}]
    faults, _ = faults_of(uav, fault, lockstep=lockstep)
    faults.begin(0)
    faults.strike(2_000_000_000)
    assert killed == []


def test_what_a_uav_sends_is_struck_within_the_time_of_the_fault():
    both = [
        {"kind": "nan", "uav": 2, "at_s": 1, "duration_s": 1},
        {"kind": "clock_offset", "uav": 2, "at_s": 1.5, "duration_s": 1, "offset_s": -0.25},
    ]
    faults, _ = faults_of(2, both)
    assert faults.sent(state(EPOCH_NS)).values.all()
    faults.begin(EPOCH_NS)
    found = [faults.sent(state(EPOCH_NS + t)) for t in (0, 1_000_000_000, 1_600_000_000)]
    assert [np.isnan(one.values[:3]).all() for one in found] == [False, True, True]
    assert found[2].stamp_ns == EPOCH_NS + 1_350_000_000
    assert np.isfinite(faults.sent(state(EPOCH_NS + 2_000_000_000)).values).all()
    again = sent_faults(load_scenario("paper_5", {"faults": both}), 2, EPOCH_NS)
    assert again(state(EPOCH_NS + 1_600_000_000)).stamp_ns == found[2].stamp_ns
    assert sent_faults(load_scenario("paper_5", {"faults": both}), 3) is None


def test_an_operators_fault_begins_now_and_is_remembered_in_words():
    faults, inbox = faults_of(3, [])
    faults.begin(EPOCH_NS)
    now_ns = EPOCH_NS + 12_340_000_000
    fault = FaultBlock.model_validate({"kind": "silence", "uav": 2, "at_s": 0, "duration_s": 1})
    faults.inject(fault, now_ns)
    inbox.on_state(2, state(now_ns + 10_000_000))
    assert inbox.state_queues[2].before(2**62, 2**62) is None
    inbox.on_state(2, state(now_ns + 1_010_000_000))
    assert inbox.state_queues[2].before(2**62, 2**62) is not None
    assert faults.injected == ["silence of uav2 at 12.3 s for 1 s"]


def test_what_is_remembered_is_limited():
    faults, _ = faults_of(3, [])
    fault = FaultBlock.model_validate({"kind": "silence", "uav": 2, "at_s": 0})
    for _ in range(100):
        faults.inject(fault, 0)
    assert len(faults.injected) == 20
