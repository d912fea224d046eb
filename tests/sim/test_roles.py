"""A flight in which UAVs come and go: each by its own deadline, and nobody else is moved."""

from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest

from ptnsbc_core.agent import HOLDING
from ptnsbc_core.behaviours.neighbour import SILENT
from ptnsbc_core.behaviours.recovery import recovery_duration
from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.step import initial_state
from ptnsbc_core.types import NeighbourMotion, NeighbourMotions
from ptnsbc_sim.roles import RoleChange, moved_on, role_changes
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory, recovery_config
from ptnsbc_sim.scenario.slots import Membership, reconfigured
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of

JUMP_M = 0.05
"""What a change of the leader moves anybody by, at most: docs/notes/membership.md."""


@lru_cache
def flight(vacancy: str = "keep") -> HeadlessFlight:
    return fly(load_scenario("relay", {"formation.vacancy": vacancy}))


def off(flown: HeadlessFlight) -> np.ndarray:
    """Distance (T, N) [m] of every UAV from its own slot beside the path of the leader."""
    scenario, times = flown.scenario, flown.t_ns * 1e-9
    path = curve_samples(leader_trajectory(scenario), times)[:, :3]
    slots = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    return np.linalg.norm(flown.truth[:, :, :3] - path[:, None] - slots, axis=2)


def test_a_joiner_is_in_its_slot_by_a_deadline_in_closed_form():
    flown, joins = flight(), 1400
    distance = off(flown)[:, 6]
    loop = flown.scenario.gains.formation
    due_s = recovery_duration(float(distance[joins]), recovery_config(flown.scenario, 7))
    due = joins + round((due_s + 1.0 / loop.kappa_1_s) * flown.scenario.timing.control_hz)
    assert distance[joins] > 5.0
    assert distance[due:3500].max() < flown.scenario.formation.tolerance_m
    assert flown.track.diagnostics[:joins, 6, HOLDING].all()
    assert not flown.track.diagnostics[joins:, 6, HOLDING].any()


def test_a_loss_moves_nobody_by_more_than_the_stated_jump():
    """The leader falls silent at 36 s, and UAV 2 leads from 36.5 s on."""
    flown = flight()
    distance = off(flown)
    others = [row for row, uav in enumerate(flown.scenario.uav_ids) if uav not in (1, 6)]
    assert distance[3600:, others].max() < JUMP_M
    estimates = flown.track.estimate[3600:3800, others, :3]
    path = curve_samples(leader_trajectory(flown.scenario), flown.t_ns[3600:3800] * 1e-9)[:, :3]
    assert np.linalg.norm(estimates - path[:, None], axis=2).max() < JUMP_M


def test_a_restarted_uav_comes_back_and_nobody_holds_meanwhile():
    flown = flight()
    holding = flown.track.diagnostics[:, :, HOLDING] > 0.0
    assert not holding[:, :5].any(), "their roles change at the tick at which they would hold"
    assert off(flown)[2490, 4] > 3.0 and off(flown)[2900, 4] < 0.05


@pytest.mark.parametrize("vacancy", ["keep", "close_up"])
def test_all_who_are_there_are_met_and_the_lost_one_is_void(vacancy):
    verdict = verdict_on(recording_of(flight(vacancy)))
    assert verdict.verdict == "met", [(one.uav, one.reason) for one in verdict.uavs]
    found = {one.uav: one for one in verdict.uavs}
    assert (found[1].verdict, found[1].reason) == ("void", "lost at 36.00 s")
    assert found[7].membership == "joined at 14.00 s"
    assert found[5].membership == "lost at 22.00 s, back at 25.01 s"
    assert found[6].membership == "left at 30.00 s"
    assert 14.0 < found[7].due_s < 22.0


def test_nobody_comes_near_another():
    flown = flight()
    places = flown.truth[:, :, :3]
    for a, b in combinations(range(places.shape[1]), 2):
        assert np.linalg.norm(places[:, a] - places[:, b], axis=1).min() >= 0.5


def test_the_same_bytes_twice_and_those_of_wait_while_nobody_goes():
    one = fly(load_scenario("relay", {"timing.duration_s": 24.0}))
    np.testing.assert_array_equal(one.truth, flight().truth[: len(one.truth)])
    wait, keep = (
        fly(load_scenario("paper_5_free", {"timing.duration_s": 3.0, "formation.vacancy": vacancy}))
        for vacancy in ("wait", "keep")
    )
    np.testing.assert_array_equal(wait.track.odometry, keep.track.odometry)
    assert not role_changes(wait.scenario)


@pytest.mark.parametrize(
    ("restart_s", "away_s", "kill_s"),
    [
        (22.23, 11.99, 36.0),  # the vehicle of the lost leader is in its way
        (17.95, 13.02, 34.32),  # UAV 3 is
        (16.31, 11.9, 29.52),  # the leader is lost just before UAV 6 leaves
        (8.73, 14.57, 36.0),  # the leader gives way to it while UAV 6 leaves
    ],
)
def test_a_uav_that_comes_back_from_afar_sees_in_time_what_stands_in_its_way(
    restart_s, away_s, kill_s
):
    faults = [
        {"kind": "restart", "uav": 5, "at_s": restart_s, "duration_s": away_s},
        {"kind": "kill", "uav": 1, "at_s": kill_s},
    ]
    keys = {"faults": faults, "timing.duration_s": 60}
    verdict = verdict_on(recording_of(fly(load_scenario("relay", keys))))
    assert verdict.verdict == "met", [(one.uav, one.reason) for one in verdict.uavs]


def stopping_way(speed, config):
    """The way [m] that a UAV on its way back needs to stop, from when something comes into the range of its sensor."""
    late = config.clearance.lag_s + config.clearance.sensor_s
    return speed * late + speed**2 / (
        2.0 * (config.clearance.deceleration - config.recovery.acceleration)
    )


@pytest.mark.parametrize("range_m", [3.0, 4.0, 8.0])
@pytest.mark.parametrize("rate", [0.05, 0.1, 0.4])
def test_two_on_their_ways_back_can_stop_within_sight_whatever_the_speed_of_the_leader(
    range_m, rate
):
    keys = {"sensor.range_m": range_m, "leader.trajectory.rate_rad_s": rate}
    config = agent_config(load_scenario("relay", keys), 5)
    room = range_m - 0.5 - config.clearance.margin_m
    left = config.filter.max_speed - 12.0 * rate
    needed = 2.0 * stopping_way(config.recovery.speed, config)
    assert needed == pytest.approx(room) or (config.recovery.speed == left and needed < room)


def test_beside_the_leader_of_relay_a_way_back_can_also_stop_before_what_stands():
    """Two speeds in any directions are together at most their sum."""
    config = agent_config(load_scenario("relay"), 5)
    room = config.clearance.range_m - 0.5 - config.clearance.margin_m
    assert stopping_way(1.2 + config.recovery.speed, config) < room


def test_who_loses_its_leader_link_forgets_the_leaders_acceleration():
    """UAV 7 hears the leader while UAV 5 is away, and UAV 5 afterwards."""
    relay = load_scenario("relay")
    before = reconfigured(relay, Membership(frozenset({5}), frozenset()))
    after = reconfigured(relay, Membership(frozenset(), frozenset({5})))
    assert (7 in before.topology.pinned, 7 in after.topology.pinned) == (True, False)
    told = NeighbourMotion((1.0, 0.0, 0.0), 20.0, (0.0, 0.12, 0.0))
    state = initial_state(flight().track.odometry[0, 6], agent_config(before, 7))
    state = moved_on(
        state._replace(motions=NeighbourMotions(told, told)), RoleChange(7, before, after)
    )
    assert state.motions == NeighbourMotions(told, SILENT)
