"""Setpoints from outside: whatever arrives, the leader stays within its limits, and what it flew stays as it was."""

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.scenario.mission.stream import (
    Setpoint,
    SetpointError,
    SetpointTrajectory,
    going_on,
    setpoints_of,
    streamed,
)
from ptnsbc_sim.scenario.mission.trajectories import trajectory_of

BLOCK = SetpointTrajectory(
    kind="stream",
    position_m=[0, 0, 4],
    low_m=[-6, -6, 2],
    high_m=[6, 6, 7],
    speed_m_s=1.5,
    acceleration_m_s2=1.2,
    jerk_m_s3=8,
    turn_rad_s=0.8,
)
BETWEEN = 1.005  # the limits are compared at 65 instants of a polynomial


def at(path, times):
    return curve_samples(path.curve, np.asarray(times, dtype=float))


def still(t, place, yaw=0.0):
    return Setpoint(t, tuple(place), (0.0, 0.0, 0.0), yaw)


def on_circle(t):
    angle, rate = 0.3 * t, 0.3
    sine, cosine = np.sin(angle), np.cos(angle)
    return Setpoint(t, (3 * sine, 3 * cosine, 4.0), (3 * rate * cosine, -3 * rate * sine, 0.0), 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_whatever_arrives_the_leader_stays_within_limits_and_region(seed):
    """In flight the path is the one that all setpoints give at once, to the last bit."""
    rng = np.random.default_rng(seed)
    t, taken, path = 0.0, [], streamed(BLOCK, ())
    for _ in range(60):
        t += rng.choice([0.02, 0.1, 0.3, 1.0, 3.0])
        place = rng.uniform(np.array(BLOCK.low_m) - 1, np.array(BLOCK.high_m) + 1)
        one = Setpoint(t, tuple(place), tuple(rng.normal(0, 0.8, 3)), rng.uniform(-4, 4))
        try:
            path = going_on(path, one)
            taken.append(one)
        except SetpointError:
            pass
    assert 15 < len(taken) < 60
    times = np.arange(0.0, t + 10.0, 0.005)
    flown = at(streamed(BLOCK, taken), times)
    assert (at(path, times[times >= taken[-1].at_s]) == flown[times >= taken[-1].at_s]).all()
    for first, limit in ((3, 1.5), (6, 1.2), (9, 8.0)):
        assert np.linalg.norm(flown[:, first : first + 3], axis=1).max() <= limit * BETWEEN
    assert np.abs(flown[:, 13]).max() <= 0.8 * BETWEEN
    assert (flown[:, :3] >= np.array(BLOCK.low_m) - 1e-3).all()
    assert (flown[:, :3] <= np.array(BLOCK.high_m) + 1e-3).all()
    assert np.abs(flown[-1, 3:12]).max() < 1e-9, "at rest, long after the last one"


def test_the_path_has_no_jump_up_to_its_jerk_and_depends_on_no_later_setpoint():
    setpoints = [on_circle(0.1 * k) for k in range(200)]
    path = streamed(BLOCK, setpoints)
    begins = np.array([one.at_s for one in setpoints[1:]])
    before, after = at(path, begins - 1e-9)[:, :12], at(path, begins)[:, :12]
    assert np.abs(after - before).max() < 1e-6
    early = streamed(BLOCK, setpoints[:50])
    times = np.arange(0.0, setpoints[50].at_s - 1e-6, 0.01)
    assert (at(early, times) == at(path, times)).all()


def test_a_stream_that_moves_is_caught_up_with_and_then_silent():
    path = streamed(BLOCK, [on_circle(0.1 * k) for k in range(300)])
    times = np.arange(18.0, 29.0, 0.01)
    wanted = np.array([on_circle(t).position for t in times])
    assert np.linalg.norm(at(path, times)[:, :3] - wanted, axis=1).max() < 0.03
    last = at(path, [29.9 + BLOCK.silent_s, 29.9 + BLOCK.silent_s + BLOCK.stop_s, 60.0])
    assert np.linalg.norm(last[0, 3:6]) == pytest.approx(0.9, rel=0.05)
    assert np.abs(last[1, 3:12]).max() < 1e-9
    assert last[1, :3] == pytest.approx(last[2, :3], abs=1e-12)


def test_a_place_is_reached_and_the_heading_turns_the_shorter_way():
    path = streamed(BLOCK, [still(0.2 * k, (2, -1, 5), 3.0) for k in range(60)])
    assert at(path, [11.9])[0, :3] == pytest.approx((2, -1, 5), abs=1e-3)
    more = [still(12.0 + 0.2 * k, (2, -1, 5), -3.0) for k in range(20)]
    path = streamed(BLOCK, [still(0.2 * k, (2, -1, 5), 3.0) for k in range(60)] + more)
    heading = at(path, np.arange(12.0, 15.0, 0.01))[:, 12]
    assert heading.min() > 2.9
    assert heading[-1] == pytest.approx(2 * np.pi - 3.0, abs=1e-3)


@pytest.mark.parametrize(
    ("one", "why"),
    [
        (still(1.0, (7, 0, 4)), "expected one from low_m to high_m"),
        (Setpoint(1.0, (0, 0, 4), (9, 0, 0), 0.0), "9 m/s: expected at most"),
        (still(0.4, (0, 0, 4)), "from 0.5 s on"),
        (still(float("nan"), (0, 0, 4)), "expected a time"),
    ],
)
def test_what_cannot_be_followed_is_refused_and_the_path_goes_on(one, why):
    path = streamed(BLOCK, [still(0.5, (1, 0, 4))])
    with pytest.raises(SetpointError, match=why):
        going_on(path, one)


def test_two_paths_to_one_setpoint_are_two():
    last = still(1.0, (1, 0, 4))
    alone, after = (
        going_on(streamed(BLOCK, first), last) for first in ((), [still(0.5, (0, 1, 4))])
    )
    assert trajectory_of(alone) is alone.curve
    assert trajectory_of(after) is after.curve


def test_rows_of_a_file():
    rows = setpoints_of("t,x,y,z,vx,vy,vz,yaw\n1,2,3,4,0.1,0.2,0.3,0.5\n")
    assert rows == (Setpoint(1.0, (2.0, 3.0, 4.0), (0.1, 0.2, 0.3), 0.5),)
    for text, why in (
        ("0,0,0,4,0,0,0,0\n1,2,3", "row 2: 3 numbers: expected t, x, y"),
        ("0,0,0,nan,0,0,0,0", "row 1: expected finite"),
        ("1,0,0,4,0,0,0,0\n1,0,0,4,0,0,0,0", "row 2 of numbers: t = 1: expected times that ascend"),
    ):
        with pytest.raises(ValueError, match=why):
            setpoints_of(text)


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"low_m": [0, 0, 9]}, "high_m"),
        ({"position_m": [0, 0, 9]}, "position_m"),
        ({"samples": "0, 0, 0, 40, 0, 0, 0, 0"}, "samples: setpoint at 0 s: position"),
        ({"samples": None, "file": "no_such.csv"}, "no_such.csv"),
    ],
)
def test_a_stream_that_cannot_be_flown_is_named(keys, why):
    given = {f"leader.trajectory.{key}": value for key, value in keys.items() if value is not None}
    with pytest.raises(ScenarioError, match=why):
        load_scenario("stream_5", given)


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"formation.frame": "heading"}, "formation.frame: heading: expected world"),
        ({"formation.assignment": "optimal"}, "formation.assignment: optimal: expected fixed"),
    ],
)
def test_what_needs_the_whole_trajectory_is_refused_beside_a_topic(keys, why):
    live = {k: v for k, v in BLOCK.model_dump().items() if v is not None}
    live = {k: list(v) if isinstance(v, tuple) else v for k, v in live.items()}
    scenario = load_scenario("paper_5_free", {"leader.trajectory": live})
    assert scenario.takes_setpoints
    with pytest.raises(ScenarioError, match=why):
        scenario.with_(keys)
