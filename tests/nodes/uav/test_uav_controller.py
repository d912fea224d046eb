"""The controller of one UAV: why it is slow, what late odometry does to it, and its place where UAVs come and go."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import MODE_FORMATION
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions, Senders
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import RoleHolder, StepTime, UavController
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
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
            place = reference_positions(path, np.array([now_ns * 1e-9]))[0]
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
        flown.inbox.on_state(1, Stamped((tick - 1) * period_ns, leader))
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
