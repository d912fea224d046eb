"""The planned path in the world, against closed forms and against flights."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.approach.deadline import shortest_deadlines, starts_of, turn_of
from ptnsbc_sim.scenario.approach.limits import limits_left
from ptnsbc_sim.scenario.approach.path import demands, plan_durations, planned_paths
from ptnsbc_sim.scenario.scenario import Scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.headless import recording_of

HOVER = {"kind": "hover", "position_m": [0, 0, 8]}
TEN_S = {"gains.formation.deadline_s": 10.0, "timing.duration_s": 14.0}


def flown_along(
    trajectory: dict[str, object], starts: dict[int, list[float]], **more: object
) -> Scenario:
    """paper_5_free with a leader of its own, relative positions, and some starts."""
    rows = {f"uavs[{uav - 1}].position_m": at for uav, at in starts.items()}
    task = {"leader.trajectory": trajectory, "formation.task": "relative_position"}
    return load_scenario("paper_5_free", {**TEN_S, **task, **rows, **more})


def test_behind_a_leader_at_rest_the_peaks_are_those_of_h():
    """10 m: 2.1875 E / T of speed, and 7.513 E / T^2 of acceleration where that is the tighter limit."""
    slow = flown_along(HOVER, {1: [0, 0, 8], 5: [1.2, 7.6, 8]}, **{"plant.quadrotor.drag_1_s": 0.0})
    deadlines = np.array([4.0, 9.0])
    lasts = plan_durations(slow, deadlines)
    wanted = 2.1875 * 10.0 / lasts / slow.gains.filter.max_speed_m_s
    found = demands(slow, starts_of(slow), 5, deadlines, 0.0)
    assert (found >= wanted - 1e-3).all()
    soft = slow.with_({"gains.filter.max_acceleration_m_s2": 1.0})
    found = demands(soft, starts_of(soft), 5, deadlines, 0.0)
    assert found == pytest.approx(7.513 * 10.0 / lasts**2, rel=2e-3)


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_uav_flies_the_path_that_is_planned(turn: float):
    """A leader that starts behind its line: within 6 cm all the way, of 12 m, without avoidance."""
    line = {"kind": "line", "position_m": [2, 0, 8], "velocity_m_s": [1.5, 0.5, 0.0]}
    starts = {1: [0, 0, 8], 2: [6, 4, 8], 3: [-8, -6, 9], 4: [5, -7, 7], 5: [-3, 8, 8]}
    level = {f"uavs[{row}].attitude_rad": [0, 0, 0] for row in range(5)}
    quiet = {f"uavs[{row}].disturbance_m_s2": [0, 0, 0] for row in range(5)}
    scenario = flown_along(
        line, starts, **{**level, **quiet, "formation.turn_rad": turn, "formation.avoidance": "off"}
    )
    flight = fly(scenario)
    t = flight.t_ns * 1e-9
    for row, uav in enumerate(scenario.uav_ids):
        times, paths = planned_paths(scenario, starts_of(scenario), uav, np.array([10.0]), turn)
        flown = np.stack(
            [np.interp(times[0], t, flight.truth[:, row, k]) for k in range(3)], axis=1
        )
        assert np.linalg.norm(flown - paths[0], axis=1).max() < 0.06


def test_a_leader_that_comes_near_needs_no_time_of_its_own():
    """It flies at 4 of 8 m/s towards four UAVs 30 m ahead: the bound takes it to fly away from them."""
    line = {"kind": "line", "position_m": [0, 0, 8], "velocity_m_s": [4.0, 0.0, 0.0]}
    ahead = {uav: [30.0, 2.0 * uav - 8.0, 8.0] for uav in (2, 3, 4, 5)}
    coming = flown_along(line, {1: [0, 0, 8], **ahead})
    behind = {uav: [-x, y, z] for uav, (x, y, z) in ahead.items()}
    leaving = flown_along(line, {1: [0, 0, 8], **behind})
    needs = [max(shortest_deadlines(one, limits_left(one)).values()) for one in (coming, leaving)]
    assert needs[0] < 10.0 < needs[1]
    assert turn_of(coming) == 0.0
    assert verdict_on(recording_of(fly(coming))).verdict == "met"
    assert verdict_on(recording_of(fly(leaving))).verdict != "met"
