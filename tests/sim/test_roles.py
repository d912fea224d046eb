"""A flight in which UAVs come and go: each by its own deadline, and nobody else is moved."""

from functools import lru_cache
from itertools import combinations

import numpy as np
import pytest

from ptnsbc_core.behaviours.recovery import recovery_duration
from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_sim.roles import role_changes
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.build import leader_trajectory, recovery_config
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.track import HOLDING
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.headless import recording_of

JUMP_M = 0.05
"""What a change of the leader moves anybody by, at most: docs/method.md."""


@lru_cache
def flight(vacancy: str = "keep") -> HeadlessFlight:
    return fly(load_scenario("relay", {"formation.vacancy": vacancy}))


def off(flown: HeadlessFlight) -> np.ndarray:
    """Distance (T, N) [m] of every UAV from its own slot beside the path of the leader."""
    scenario, times = flown.scenario, flown.t_ns * 1e-9
    path = reference_positions(leader_trajectory(scenario), times)
    slots = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    return np.linalg.norm(flown.truth[:, :, :3] - path[:, None] - slots, axis=2)


def test_a_joiner_is_in_its_slot_by_a_deadline_in_closed_form():
    flown, joins = flight(), 1400
    distance = off(flown)[:, 6]
    loop = flown.scenario.gains.formation
    due_s = recovery_duration(float(distance[joins]), recovery_config(flown.scenario, 7))
    due = joins + round((due_s + 1.0 / loop.kappa_1_s) * flown.scenario.control_hz)
    assert distance[joins] > 5.0
    assert distance[due:3500].max() < flown.scenario.file.formation.tolerance_m
    assert flown.track.diagnostics[:joins, 6, HOLDING].all()
    assert not flown.track.diagnostics[joins:, 6, HOLDING].any()


def test_a_loss_moves_nobody_by_more_than_the_stated_jump():
    """The leader falls silent at 36 s, and UAV 2 leads from 36.5 s on."""
    flown = flight()
    distance = off(flown)
    others = [row for row, uav in enumerate(flown.scenario.uav_ids) if uav not in (1, 6)]
    assert distance[3600:, others].max() < JUMP_M
    estimates = flown.track.estimate[3600:3800, others, :3]
    path = reference_positions(leader_trajectory(flown.scenario), flown.t_ns[3600:3800] * 1e-9)
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
    assert 14.0 < found[7].due_s < 19.0


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
