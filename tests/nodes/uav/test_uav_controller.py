"""The controller of one UAV: why it is slow, what late odometry does to it, and its place where UAVs come and go."""

from __future__ import annotations

import math
import os
from collections import deque

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.types import MODE_FORMATION, MODE_HOLD
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.announcements import Decision
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions, Senders
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS, Inbox
from ptnsbc_nodes.uav.step_log import sources, used_by
from ptnsbc_nodes.uav.uav_controller import (
    RoleHolder,
    SlotDecider,
    StepTime,
    UavController,
    UavFaults,
    UavFlight,
    at_epoch,
    step_time,
)
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.scenario import Scenario, agent_config, load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.slots import optimal_slots, with_slots
from ptnsbc_sim.world import World

SECOND_NS = 1_000_000_000


def controller(scenario: Scenario, uav: int, senders: Senders) -> UavController:
    """A controller that hears these senders alone."""
    made = UavController(scenario, uav, CommunicationGraph(scenario, FlightOptions()))
    made.inbox.listen_to(senders)
    return made


@pytest.mark.parametrize(
    ("avoidance", "seen_s", "stale"),
    [("set_based", 2.6, False), ("set_based", 2.4, True), ("off", 2.4, False)],
)
def test_near_objects_that_are_not_refreshed_are_told(
    avoidance: str, seen_s: float, stale: bool
) -> None:
    scenario = load_scenario("paper_5_free", {"formation.avoidance": avoidance})
    flown = controller(scenario, 1, Senders(None, None, ()))
    values = np.zeros(13)
    values[6] = 1.0
    flown.inbox.own = Stamped(3 * SECOND_NS, values)
    flown.inbox.near = Stamped(round(seen_s * SECOND_NS), np.zeros((0, 7)))
    at = StepTime(3 * SECOND_NS, 10_000_000, MODE_FORMATION, 0, 0, True)
    flown.step(at, NO_CUTOFF_NS)
    assert flown.near_stale is stale


def leader_off_m(late_ticks: int) -> float:
    """Largest distance [m] of the leader from its path after 10 s, by odometry that is so old at every tick."""
    scenario = load_scenario("relay", {"formation.avoidance": "off"})
    world, path = World(scenario), leader_trajectory(scenario)
    flown = controller(scenario, 1, Senders(None, None, ()))
    flown.inbox.near = Stamped(0, np.zeros((0, 7)))
    odometry: deque[Stamped] = deque(maxlen=late_ticks + 1)
    wrenches = {uav: np.zeros(6) for uav in world.ids}
    largest = 0.0
    for tick in range(2000):
        now_ns = tick * scenario.timing.dt_ns
        odometry.append(Stamped(now_ns, world.odometry(1).copy()))
        flown.inbox.own = odometry[0]
        at = StepTime(now_ns, scenario.timing.dt_ns, MODE_FORMATION, 0, 0, True)
        wrenches[1] = flown.step(at, NO_CUTOFF_NS).wrench.copy()
        if tick >= 1000:
            place = curve_samples(path, np.array([now_ns * 1e-9]))[:, :3][0]
            largest = max(largest, float(np.linalg.norm(world.truth(1)[0:3] - place)))
        world.step(wrenches)
    return largest


def test_late_odometry_does_not_move_the_leader_ahead_of_its_path() -> None:
    """At 1.2 m/s it would be 12 mm ahead with odometry of one tick ago."""
    fresh, one, two = (leader_off_m(ticks) for ticks in (0, 1, 2))
    assert fresh < 0.001
    assert one < 0.002
    assert two < 0.006


@pytest.mark.parametrize("late_ticks", [0, 3])
def test_an_estimate_is_of_the_time_that_its_message_has(late_ticks: int) -> None:
    scenario = load_scenario("paper_5_free")
    flown = controller(scenario, 2, Senders(1, 1, ()))
    flown.inbox.near = Stamped(0, np.zeros((0, 7)))
    velocity, start, period_ns = np.array([1.2, 0.0, -0.3]), np.array([5.0, 0.0, 3.0]), 10_000_000

    def leader_at(tick: int) -> np.ndarray:
        return start + velocity * tick * period_ns * 1e-9

    for tick in range(late_ticks, 300):
        leader = np.concatenate((leader_at(tick - 1), [0.0, 0.0, 0.0, 1.0], velocity, np.zeros(3)))
        flown.inbox.state_queues[1].put(Stamped((tick - 1) * period_ns, leader))
        beside = leader_at(tick) + np.array([2.0, 0.0, 0.0])
        own = np.concatenate((beside, [0.0, 0.0, 0.0, 1.0], np.zeros(6)))
        flown.inbox.own = Stamped((tick - late_ticks) * period_ns, own)
        at = StepTime(tick * period_ns, period_ns, MODE_FORMATION, 0, 0, True)
        outputs = flown.step(at, NO_CUTOFF_NS)
    np.testing.assert_allclose(outputs.leader_estimate[0:3], leader_at(299 - late_ticks), atol=1e-6)


ROLE_DT_NS = 10_000_000
FRESH = dict.fromkeys(range(2, 8), 0.01)


@pytest.mark.parametrize(("pause_s", "leads"), [(0.4, True), (0.6, False)])
def test_a_leader_whose_process_stood_still_knows_that_it_was_lost(pause_s, leads):
    """SIGSTOP, or a computer that is too busy: the others follow the successor by then."""
    relay = load_scenario("relay")
    role = RoleHolder(relay, 1)
    for tick in range(100):
        role.look(tick * ROLE_DT_NS, 0, FRESH)
    assert role.leads
    role.look(99 * ROLE_DT_NS + round(pause_s * 1e9), 0, FRESH)
    assert role.leads is leads


OPEN = {"formation.assignment": "optimal", "formation.task": "relative_position"}
BASE = load_scenario("paper_5_free", OPEN)
LEVEL = [{"id": uav, "position_m": BASE.uav(uav).position.tolist()} for uav in BASE.uav_ids]
SCENARIO = load_scenario("paper_5_free", {**OPEN, "uavs": LEVEL})
EDGES = CommunicationGraph(SCENARIO, FlightOptions())
FIRST = {1: 1, 2: 2, 3: 3, 4: 4, 5: 5}
SECOND = {1: 3, 2: 5, 3: 4, 4: 1, 5: 2}


def odometry(at: np.ndarray, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array([*at, 0.0, 0.0, 0.0, 1.0, *velocity, 0.0, 0.0, 0.0])


def new_uav(uav: int) -> UavFlight:
    """One UAV as its process flies it, without ROS around it."""
    return UavFlight(SCENARIO, uav, EDGES)


def test_any_uav_can_be_heard_and_those_of_the_slot_are_used() -> None:
    one = new_uav(5)
    assert EDGES.senders(5).heard_states == (1, 2, 3, 4)
    inbox = one.controller.inbox
    assert set(inbox.state_queues) == set(inbox.estimate_queues) == {1, 2, 3, 4}
    assert one.controller.inbox.senders.states == (1, 4)
    epochs = Epochs(SCENARIO)
    epochs.announce(0, "form")
    one.decided.keep(Decision(0, SECOND))
    assert one.take_slot(step_time(0, 0, epochs.at(0), 0))
    assert one.controller.inbox.senders.states == (4,)  # slot 2 has the leader as parent: UAV 4
    assert one.controller.inbox.senders.estimators == (1,)  # of slot 3
    held = agent_config(with_slots(SCENARIO, SECOND), 5)
    np.testing.assert_equal(tuple(one.controller.config), tuple(held))
    assert sources(one.controller.inbox.senders)[-1] == "slots"
    used = used_by(one.controller)[-1]
    assert used is not None
    assert (used.stamp_ns, used.values.tolist()) == (0, [3, 5, 4, 1, 2])


def test_fixed_slots_hear_nobody_else() -> None:
    fixed = load_scenario("paper_5_free")
    senders = CommunicationGraph(fixed, FlightOptions()).senders(5)
    assert (senders.others, senders.heard_states, senders.heard_estimators) == ((), (1, 4), (4,))
    assert "slots" not in sources(senders)


def test_a_leg_without_a_decision_is_not_flown_and_says_so() -> None:
    one, epochs = new_uav(3), Epochs(SCENARIO)
    assert one.take_slot(step_time(0, 0, epochs.at(0), 0))  # no leg yet
    epochs.announce(2_000_000_000, "form")
    leg = epochs.at(2_000_000_000)
    assert not one.take_slot(step_time(0, 0, leg, 0))
    assert one.slots_fault(leg) == ("holding: no slots of the epoch at 2.000 s on /formation/slots")
    one.decided.keep(Decision(1_000_000_000, FIRST))  # of another epoch
    assert one.slots_fault(leg)
    one.decided.keep(Decision(2_000_000_000, SECOND))
    assert one.take_slot(step_time(0, 0, leg, 0))
    assert one.slots_fault(leg) == ""
    epochs.announce(3_000_000_000, "hold")
    taken = one.controller.inbox.senders
    assert one.take_slot(step_time(3_000_000_000, 0, epochs.at(3_000_000_000), 0))  # keeps its slot
    assert one.controller.inbox.senders is taken


def test_limits_of_the_vehicle_outlive_the_slot() -> None:
    one, epochs = new_uav(3), Epochs(SCENARIO)
    epochs.announce(0, "form")
    filtered = one.controller.config.filter._replace(max_speed=1.25)
    one.controller.config = one.controller.config._replace(filter=filtered)
    one.decided.keep(Decision(0, SECOND))
    one.take_slot(step_time(0, 0, epochs.at(0), 0))
    assert one.controller.config.filter == filtered


def test_the_decision_waits_for_the_odometry_of_all() -> None:
    said: list[Decision] = []
    decider = SlotDecider(SCENARIO, said.append)
    decider.decide(7)
    for uav in SCENARIO.uav_ids:
        assert said == []
        at = SCENARIO.uav(SECOND[uav]).position
        decider.on_odometry(uav, Stamped(0, odometry(at)))
    assert said == [Decision(7, SECOND)]
    decider.on_odometry(1, Stamped(1, odometry(np.zeros(3))))
    assert len(said) == 1  # decided once
    decider.decide(8)
    assert [one.t0_ns for one in said] == [7, 8]


def test_a_later_decision_takes_the_places_of_its_time() -> None:
    """The shape has turned by 1.2 rad since the first epoch."""
    turn = {"at_s": 6.0, "over_s": 2.0, "rotation_rad": 1.2}
    changes = {"formation.task": "relative_position", "formation.changes": [turn]}
    scenario = load_scenario("paper_5_free", {**changes, "formation.assignment": "optimal"})
    said: list[Decision] = []
    decider = SlotDecider(scenario, said.append)
    starts = {uav: scenario.offset(uav) for uav in scenario.uav_ids}
    for uav, place in starts.items():
        decider.on_odometry(uav, Stamped(0, odometry(place)))
    for t0_s in (3, 11):
        decider.decide(round(t0_s * 1e9))
    assert said[0].slots == {uav: uav for uav in scenario.uav_ids}
    cosine, sine = math.cos(1.2), math.sin(1.2)
    turned = {
        uav: [cosine * x - sine * y, sine * x + cosine * y, z]
        for uav, (x, y, z) in scenario.formation.offsets_m.items()
    }
    there = load_scenario("paper_5_free", {"formation.offsets_m": turned})
    assert said[1].slots == optimal_slots(there, starts) != said[0].slots


def test_odometry_that_is_missing_or_late_is_unknown() -> None:
    decider = SlotDecider(SCENARIO, lambda decision: None)
    for uav in (1, 2, 3):
        decider.on_odometry(uav, Stamped(100 * uav, odometry(np.zeros(3))))
    assert decider.unknown(200) == [1, 4, 5]


def test_positions_are_those_at_the_epoch() -> None:
    """Half a second at 2 m/s forwards, with the nose to the north."""
    north = odometry(np.array([1.0, 2.0, 3.0]), (2.0, 0.0, 0.5))
    north[3:7] = 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)
    found = at_epoch(Stamped(1_000_000_000, north), 1_500_000_000)
    np.testing.assert_allclose(found, [1.0, 3.0, 3.25], atol=1e-12)
    np.testing.assert_array_equal(at_epoch(Stamped(5, north), 5), north[:3])
    np.testing.assert_array_equal(at_epoch(Stamped(9, north), 5), north[:3])  # of after the epoch


def flown(slots: list[tuple[int, dict[int, int]]], ticks: int, late_ns: int = 0) -> np.ndarray:
    """Positions (T, 5, 3) of UAVs that begin a leg with these slots at each epoch [ns].

    UAV 3 hears of each decision `late_ns` after its epoch.
    """
    world, period_ns = World(SCENARIO), SCENARIO.timing.dt_ns
    uavs = {uav: new_uav(uav) for uav in world.ids}
    epochs = Epochs(SCENARIO)
    for t0_ns, _ in slots:
        epochs.announce(t0_ns, "form")
    sent: dict[int, tuple[Stamped, Stamped]] = {}
    places = np.empty((ticks, len(uavs), 3))
    for tick in range(ticks):
        now_ns = tick * period_ns
        leg, wrenches, now = epochs.at(now_ns), {}, {}
        for t0_ns, decision in slots:
            for uav, one in uavs.items():
                if now_ns >= t0_ns + (late_ns if uav == 3 else 0):
                    one.decided.keep(Decision(t0_ns, decision))
        for row, (uav, one) in enumerate(uavs.items()):
            controller = one.controller
            own = Stamped(now_ns, world.odometry(uav).copy())
            places[tick, row] = own.values[:3]
            controller.inbox.own, controller.inbox.near = own, Stamped(now_ns, np.zeros((0, 7)))
            for other, (state, estimate) in sent.items():
                if other != uav:
                    controller.inbox.state_queues[other].put(state)
                    controller.inbox.estimate_queues[other].put(estimate)
            at = step_time(now_ns, period_ns, leg, 0)
            if not one.take_slot(step_time(0, 0, leg, 0)):
                at = at._replace(mode=MODE_HOLD)
            out = controller.step(at, NO_CUTOFF_NS)
            told = own.values.copy()
            told[7:10] = out.reported
            now[uav] = Stamped(now_ns, told), Stamped(now_ns, out.leader_estimate.copy())
            wrenches[uav] = out.wrench.copy()
        sent = now
        world.step(wrenches)
    return places


def errors(places: np.ndarray, slots: dict[int, int], first: int) -> np.ndarray:
    """Distance (T, 5) [m] from the places of these slots from a tick on."""
    held = with_slots(SCENARIO, slots)
    found = places[first:]
    leader = list(held.uav_ids).index(held.leader.id)
    goal = found[:, [leader]] + np.array([held.offset(uav) for uav in held.uav_ids])
    times = np.arange(first, first + len(found)) * 0.01
    goal[:, leader] = curve_samples(leader_trajectory(held), times)[:, :3]
    return np.linalg.norm(found - goal, axis=2)


def test_a_later_leg_decides_anew() -> None:
    """Another leader, other parents, and a formation again at the deadline."""
    t0_s = 6.0
    places = flown([(0, FIRST), (round(t0_s * 1e9), SECOND)], 1250)
    assert errors(places, FIRST, 500)[:100].max() < 0.02
    later = errors(places, SECOND, 600)
    assert later[0].max() > 1.0
    assert later[500:].max() < 0.02
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=2) * 100.0
    assert np.abs(np.diff(speeds[550:], axis=0)).max() < 0.25  # no kick at the epoch


def test_who_hears_of_the_decision_late_holds_and_is_in_place_all_the_same() -> None:
    places = flown([(0, SECOND)], 700, late_ns=300_000_000)
    start = SCENARIO.uav(3).position
    assert np.linalg.norm(places[30, 2] - start) < 0.02
    assert errors(places, SECOND, 500).max() < 0.05


EPOCH_NS = 5_000_000_000
MANY = [
    {"kind": "silence", "uav": 2, "at_s": 0.5, "duration_s": 0.3},
    {"kind": "loss", "uav": 2, "at_s": 1.0, "duration_s": 1.0, "share": 0.4},
    {"kind": "delay", "uav": 2, "at_s": 1.2, "duration_s": 0.6, "delay_s": 0.2},
]


def faults_of(uav, faults, *, lockstep=False):
    scenario = load_scenario("paper_5", {"faults": faults, "timing.duration_s": 2.5})
    return UavFaults(scenario, uav, lockstep=lockstep)


def inbox_of(uav, faults):
    scenario = load_scenario("paper_5", {"faults": faults, "timing.duration_s": 2.5})
    return Inbox(CommunicationGraph(scenario, FlightOptions()).senders(uav))


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
    inbox = inbox_of(3, MANY)
    scenario = load_scenario("paper_5", {"faults": MANY, "timing.duration_s": 2.5})
    inbox.begin(0)
    expected, dt_ns = last_state_received(scenario, 3, 2), scenario.timing.dt_ns
    for tick in range(scenario.timing.ticks):
        inbox.state_queues[2].put(state(tick * dt_ns))
        heard = inbox.state_queues[2].before(tick * dt_ns, tick * dt_ns)
        assert (-1 if heard is None else heard.stamp_ns // dt_ns) == expected[tick], tick


def test_faults_count_from_the_first_epoch_and_only_once():
    inbox = inbox_of(3, [{"kind": "silence", "uav": 2, "at_s": 1}])
    before, after = EPOCH_NS + 990_000_000, EPOCH_NS + 1_010_000_000
    inbox.state_queues[2].put(state(2_000_000_000))  # before the epoch nothing is struck
    inbox.begin(EPOCH_NS)
    inbox.begin(EPOCH_NS - 1_000_000_000)  # another leg
    inbox.state_queues[2].put(state(before))
    inbox.state_queues[2].put(state(after))
    assert inbox.state_queues[2].before(2**62, 2**62).stamp_ns == before
    assert inbox.state_queues[2].newest_ns == after


def test_in_lockstep_a_uav_ends_itself_at_its_tick(killed):
    faults = faults_of(2, [{"kind": "kill", "uav": 2, "at_s": 1}], lockstep=True)
    faults.begin(0)
    faults.strike(990_000_000)
    assert killed == []
    faults.strike(1_000_000_000)
    assert killed == [os.getpid()]


@pytest.mark.parametrize(("uav", "lockstep"), [(2, False), (3, True)])
def test_in_real_time_the_launcher_kills_and_nobody_ends_for_another(killed, uav, lockstep):
    fault = [{"kind": "kill", "uav": 2, "at_s": 1}]
    faults = faults_of(uav, fault, lockstep=lockstep)
    faults.begin(0)
    faults.strike(2_000_000_000)
    assert killed == []


def test_what_a_uav_sends_is_struck_within_the_time_of_the_fault():
    both = [
        {"kind": "nan", "uav": 2, "at_s": 1, "duration_s": 1},
        {"kind": "clock_offset", "uav": 2, "at_s": 1.5, "duration_s": 1, "offset_s": -0.25},
    ]
    faults = faults_of(2, both)
    assert faults.sending(state(EPOCH_NS)).values.all()
    faults.begin(EPOCH_NS)
    found = [faults.sending(state(EPOCH_NS + t)) for t in (0, 1_000_000_000, 1_600_000_000)]
    assert [np.isnan(one.values[:3]).all() for one in found] == [False, True, True]
    assert found[2].stamp_ns == EPOCH_NS + 1_350_000_000
    assert np.isfinite(faults.sending(state(EPOCH_NS + 2_000_000_000)).values).all()
    assert faults_of(3, both).sending is None
