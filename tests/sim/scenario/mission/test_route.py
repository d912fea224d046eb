"""The path of the leader through the legs of a mission."""

from typing import Any

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import course_samples
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.timebase import h
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.build import leader_trajectory
from ptnsbc_sim.scenario.mission.legs import Word
from ptnsbc_sim.scenario.mission.trajectories import trajectory_of

EIGHT = {
    "kind": "lissajous",
    "centre_m": [0, 0, 8],
    "amplitude_m": [10, 5, 0],
    "rate_rad_s": [0.1, 0.2, 0],
    "heading": "path",
}
POINTS = {"kind": "waypoints", "points_m": [[0, 0, 8], [6, 4, 9], [8, -2, 8]], "speed_m_s": 1.0}
CURVES = {
    "lissajous": EIGHT,
    "circle": {"kind": "circle", "centre_m": [0, 0, 5], "radius_m": 5, "rate_rad_s": 0.3},
    "line": {"kind": "line", "position_m": [0, 0, 5], "velocity_m_s": [1, 0, 0]},
    "minimum_snap": POINTS,
    "cubic": {**POINTS, "through": "cubic"},
    "straight": {**POINTS, "through": "straight"},
    "closed": {**POINTS, "closed": True},
}


def flight(*legs: dict[str, Any], first: dict[str, Any] | None = None) -> Scenario:
    changes = {
        "leader.trajectory": first or {"kind": "hover", "position_m": [0, 0, 5]},
        "timing.duration_s": 60,
        "mission": {"legs": [{"kind": "form", "over_s": 6}, *legs]},
    }
    return load_scenario("paper_5_free", changes)


def path(scenario: Scenario, times: Array) -> Array:
    return course_samples(leader_trajectory(scenario), times)


def test_from_rest_to_rest_it_is_the_time_profile_of_the_method() -> None:
    found = flight({"kind": "go_to", "position_m": [10, -4, 7], "over_s": 5})
    times = np.linspace(6.0, 11.0, 101)
    share = np.array([h((t - 6.0) / 5.0) for t in times])
    wanted = np.array([0, 0, 5]) + share[:, None] * np.array([10, -4, 2])
    np.testing.assert_allclose(path(found, times)[:, :3], wanted, atol=1e-12)
    assert np.allclose(path(found, np.array([0.0, 3.0, 30.0]))[:, 3:12], 0.0)


@pytest.mark.parametrize("kind", CURVES)
def test_who_has_joined_a_trajectory_is_on_it(kind: str) -> None:
    found = flight({"kind": "follow", "over_s": 3, "trajectory": CURVES[kind]})
    block = found.file.mission.legs[1].trajectory  # type: ignore[union-attr]
    times = np.linspace(9.0, 59.0, 2000)
    wanted = course_samples(trajectory_of(block), times - 6.0)
    np.testing.assert_allclose(path(found, times)[:, :9], wanted[:, :9], atol=1e-6)


@pytest.mark.parametrize("kind", CURVES)
def test_it_has_no_jump_from_leg_to_leg(kind: str) -> None:
    """Position, velocity, acceleration and heading on both sides of every joint."""
    found = flight(
        {"kind": "follow", "over_s": 3, "stay_s": 4, "trajectory": CURVES[kind]},
        {"kind": "go_to", "position_m": [3, 3, 6], "over_s": 6, "yaw_rad": 2.0},
        {"kind": "hold", "over_s": 2},
        first=CURVES["circle"],
    )
    joints = np.array([6.0, 9.0, 13.0, 19.0, 21.0])
    before, after = path(found, joints - 1e-7), path(found, joints + 1e-7)
    np.testing.assert_allclose(before[:, :9], after[:, :9], atol=1e-5)
    np.testing.assert_allclose(before[:, 12:14], after[:, 12:14], atol=1e-4)
    assert path(found, np.array([25.0]))[0, 12] == pytest.approx(2.0)


def test_its_velocity_is_the_rate_of_its_position() -> None:
    found = flight({"kind": "follow", "over_s": 4, "trajectory": EIGHT}, first=CURVES["circle"])
    times, step = np.linspace(0.5, 40.0, 400), 1e-5
    later, earlier = path(found, times + step), path(found, times - step)
    slope = (later[:, :9] - earlier[:, :9]) / (2 * step)
    np.testing.assert_allclose(slope, path(found, times)[:, 3:12], atol=1e-4)
    turn = (later[:, 12] - earlier[:, 12]) / (2 * step)
    np.testing.assert_allclose(turn, path(found, times)[:, 13], atol=1e-4)


def test_who_holds_comes_to_rest_in_the_time_of_the_leg() -> None:
    found = flight({"kind": "hold", "over_s": 4}, first=CURVES["line"])
    at = path(found, np.array([6.0, 10.0, 30.0]))
    assert at[0, 3] == pytest.approx(1.0)
    assert at[:, 0] == pytest.approx([6.0, 8.0, 8.0])
    assert np.allclose(at[1:, 3:12], 0.0)


def test_a_word_changes_nothing_of_what_was_flown_before_it() -> None:
    """Bit by bit: it does not matter when a UAV hears of it."""
    found = flight(
        {"kind": "follow", "over_s": 3, "trajectory": EIGHT},
        {"kind": "go_to", "position_m": [9, 9, 9], "over_s": 9, "on": "word"},
    )
    said = found.with_words([Word(3, 20.0)])
    times = np.linspace(0.0, 20.0, 1001)[:-1]
    assert path(found, times).tobytes() == path(said, times).tobytes()
    assert path(said, np.array([29.0]))[0, :3] == pytest.approx([9, 9, 9])


def test_a_word_may_come_in_the_middle_of_a_leg() -> None:
    found = flight({"kind": "go_to", "position_m": [9, 9, 9], "over_s": 9})
    said = found.with_words([Word(0, 10.0)])
    joint = np.array([10.0])
    np.testing.assert_allclose(path(said, joint - 1e-7), path(said, joint + 1e-7), atol=1e-5)
    assert np.allclose(path(said, np.array([14.0]))[0, 3:12], 0.0)


def test_a_path_of_too_many_pieces_is_refused() -> None:
    circle = {"kind": "circle", "centre_m": [0, 0, 5], "radius_m": 0.1, "rate_rad_s": 500.0}
    with pytest.raises(PtnsbcError, match=r"mission\.legs: the path of the leader takes more than"):
        flight({"kind": "follow", "over_s": 3, "trajectory": circle})
