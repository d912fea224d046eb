"""The path of the leader through the legs of a mission, and that of a group that leaves and joins again."""

from typing import Any

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.timebase import h
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.constants import agent_config, leader_trajectory
from ptnsbc_sim.scenario.mission.legs import CANCEL, Word, is_cut_short
from ptnsbc_sim.scenario.mission.pieces import at_knots, summed
from ptnsbc_sim.scenario.mission.route import places_beside_leader
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
SPLIT = {
    "kind": "split",
    "head": 3,
    "over_s": 6,
    "trajectory": {"kind": "circle", "centre_m": [0, -9, 7], "radius_m": 4, "rate_rad_s": 0.3},
}
JOIN = {"kind": "join", "over_s": 8}
HOLD = {"kind": "hold", "over_s": 4}
CHANGE = {"kind": "change", "scale": [1, 2, 1], "over_s": 5}


def flight(*legs: dict[str, Any], first: dict[str, Any] | None = None) -> Scenario:
    changes = {
        "leader.trajectory": first or {"kind": "hover", "position_m": [0, 0, 5]},
        "timing.duration_s": 60,
        "mission": {"legs": [{"kind": "form", "over_s": 6}, *legs]},
    }
    return load_scenario("paper_5_free", changes)


def path(scenario: Scenario, times: Array) -> Array:
    return curve_samples(leader_trajectory(scenario), times)


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
    block = found.mission.legs[1].trajectory  # type: ignore[union-attr]
    times = np.linspace(9.0, 59.0, 2000)
    wanted = curve_samples(trajectory_of(block), times - 6.0)
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
    with pytest.raises(
        PtnsbcError, match=r"mission\.legs: the path of the leader or of a group takes more than"
    ):
        flight({"kind": "follow", "over_s": 3, "trajectory": circle})


def mission(*legs: dict[str, Any], **keys: Any) -> Scenario:
    form = {"kind": "form", "over_s": 7}
    return load_scenario("split_join", {"mission": {"legs": [form, *legs]}, **keys})


def places(scenario: Scenario, uav: int, times: Array) -> Array:
    """Place of a UAV in the world (T, 3) [m] by the scenario."""
    lead = curve_samples(leader_trajectory(scenario), times)[:, :3]
    return np.asarray(lead + places_beside_leader(scenario, uav, times))


def test_the_head_flies_its_trajectory_and_its_group_keeps_its_places() -> None:
    """Also while the leader goes elsewhere and the shape changes."""
    found = load_scenario("split_join")
    split, join = found.legs[2], found.legs[4]
    times = np.linspace(split.due_s, join.begin_s, 400)
    wanted = curve_samples(trajectory_of(split.leg.trajectory), times - split.begin_s)[:, :3]
    np.testing.assert_allclose(places(found, 3, times), wanted, atol=1e-9)
    late = np.array([join.begin_s])
    wide = np.array([1.0, 1.4, 1.0])
    for uav in (5, 6, 7):
        beside = places(found, uav, late) - places(found, 3, late)
        np.testing.assert_allclose(beside[0], wide * (found.offset(uav) - found.offset(3)))
    for uav in (2, 4):
        np.testing.assert_allclose(
            places_beside_leader(found, uav, late)[0], wide * found.offset(uav)
        )


def test_before_it_leaves_and_after_it_has_joined_the_formation_is_whole() -> None:
    found, whole = mission(SPLIT, JOIN), mission(HOLD)
    for uav in found.followers:
        for times in (np.linspace(0.0, 6.99, 50), np.linspace(21.0, 59.0, 50)):
            beside = places_beside_leader(found, uav, times)
            np.testing.assert_allclose(
                beside, np.tile(whole.offset(uav), (len(times), 1)), atol=1e-9
            )


@pytest.mark.parametrize("uav", [2, 3, 5])
def test_no_place_jumps(uav: int) -> None:
    """Nor do velocity and acceleration of any place, and each is the rate of the one before."""
    found = load_scenario("split_join")
    times, step = np.linspace(7.0, 59.0, 5201), 1e-4
    now = places(found, uav, times)
    ahead, behind = places(found, uav, times + step), places(found, uav, times - step)
    rate = (ahead - behind) / (2 * step)
    bend = (ahead - 2 * now + behind) / step**2
    assert np.linalg.norm(np.diff(now, axis=0), axis=1).max() < 0.01 * 3.5
    assert np.linalg.norm(np.diff(rate, axis=0), axis=1).max() < 0.01 * 1.5
    assert np.linalg.norm(np.diff(bend, axis=0), axis=1).max() < 0.05


def test_what_a_child_is_told_of_its_parent_is_the_place_of_the_parent() -> None:
    found, times = load_scenario("split_join"), np.linspace(0.0, 59.0, 200)
    for uav in (3, 5, 6, 7):
        table = agent_config(found, uav).shape.table
        own, parent = at_knots(table[:, :25], times_of(table)), table[:, [0, *range(25, 49)]]
        above = found.communication.parent(uav)
        assert above is not None
        for part, who in ((own, uav), (parent, above)):
            curve = np.column_stack([part, np.zeros((len(part), 8))])
            given = curve_samples(leader_trajectory(found)._replace(table=curve), times)[:, :3]
            np.testing.assert_allclose(given, places_beside_leader(found, who, times), atol=1e-9)


def times_of(table: Array) -> Array:
    return np.asarray(table[:, 0])


@pytest.mark.parametrize(
    "word", [Word(CANCEL, 20.0), Word(6, 18.0), Word(5, 25.0), Word(6, 36.0), Word(CANCEL, 36.0)]
)
def test_a_word_changes_no_place_before_it(word: Word) -> None:
    """Bit by bit: it does not matter when a UAV hears of it."""
    found = load_scenario("split_join")
    said, times = found.with_words([word]), np.linspace(0.0, word.at_s, 1001)[:-1]
    for uav in found.followers:
        before, after = (places_beside_leader(one, uav, times) for one in (found, said))
        assert before.tobytes() == after.tobytes()


def test_a_cancelled_group_comes_to_rest_with_the_leader() -> None:
    found = load_scenario("split_join")
    said = found.with_words([Word(CANCEL, 20.0)])
    split = said.legs[2]
    assert is_cut_short(said.legs, split)
    at = places(said, 3, np.array([24.0, 24.1, 40.0]))
    np.testing.assert_allclose(at, np.tile(at[0], (3, 1)), atol=1e-9)
    joined = said.with_words([*said.words, Word(5, 30.0)])
    beside = places_beside_leader(joined, 3, np.array([42.0]))[0]
    np.testing.assert_allclose(beside, found.offset(3), atol=1e-9)


def test_a_join_that_has_begun_is_completed() -> None:
    said = load_scenario("split_join").with_words([Word(CANCEL, 40.0)])
    assert not is_cut_short(said.legs, said.legs[4])
    wide = said.offset(3) * np.array([1.0, 1.4, 1.0])
    np.testing.assert_allclose(places_beside_leader(said, 3, np.array([47.0]))[0], wide, atol=1e-9)


def test_tables_are_summed_at_the_knots_of_both() -> None:
    rng = np.random.default_rng(5)
    one = np.column_stack([[0.0, 1.0, 2.5], rng.normal(size=(3, 32))])
    other = np.column_stack([[0.0, 0.7, 2.5, 4.0], rng.normal(size=(4, 24))])
    total = summed(one, other, -1.0)
    assert total[:, 0].tolist() == [0.0, 0.7, 1.0, 2.5, 4.0]
    for t in (0.3, 0.9, 1.7, 3.1, 4.4):
        for channel in range(4):
            parts = [
                value(table, channel, t) for table in (one, other, total) if width(table, channel)
            ]
            wanted = parts[0] - parts[1] if channel < 3 else parts[0]
            assert parts[-1] == pytest.approx(wanted, rel=1e-9)


def width(table: Array, channel: int) -> bool:
    return table.shape[1] > 1 + 8 * channel


def value(table: Array, channel: int, t: float) -> float:
    row = int(np.searchsorted(table[:, 0], t, side="right")) - 1
    first = 1 + 8 * channel
    return float(np.polyval(table[row, first : first + 8], t - table[row, 0]))


@pytest.mark.parametrize(
    ("legs", "keys", "message"),
    [
        ([JOIN], {}, r"legs\[1\]\.kind: join: expected a leg of kind split before it"),
        ([{**JOIN, "on": "word"}], {}, r"legs\[1\]\.kind: join: expected a leg of kind split"),
        ([SPLIT, SPLIT], {}, r"legs\[2\]\.kind: split: expected a leg of kind join before it"),
        ([SPLIT, JOIN, JOIN], {}, r"legs\[3\]\.kind: join: expected a leg of kind split"),
        ([{**SPLIT, "head": 1}], {}, r"legs\[1\]\.head: 1: expected one of the followers"),
        ([{**SPLIT, "head": 9}], {}, r"legs\[1\]\.head: 9: expected one of the followers"),
        ([SPLIT], {"formation.frame": "heading"}, r"frame: heading: expected world beside a leg of kind split"),
        ([SPLIT], {"formation.assignment": "optimal"}, r"optimal: expected fixed beside a leg of kind split"),
        ([SPLIT, {**CHANGE, "rotation_rad": 1}], {}, r"mission.legs: expected no leg of kind change with"),
        ([SPLIT], {"formation.task": "parent_angle"}, r"formation\.task: parent_angle: expected rel"),
        ([SPLIT], {"formation.vacancy": "keep"}, r"or legs of kind take_off, change or split beside"),
    ],
)  # fmt: skip
def test_a_group_that_cannot_leave_is_refused(
    legs: list[dict[str, Any]], keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(PtnsbcError, match=message):
        mission(*legs, **keys)


def test_a_word_that_does_not_fit_where_it_is_said_is_refused() -> None:
    found = load_scenario("split_join")
    with pytest.raises(PtnsbcError, match="split-3: expected a leg of kind join before it"):
        found.with_words([Word(3, 25.0)])
    with pytest.raises(PtnsbcError, match="join-5: expected a leg of kind split before it"):
        found.with_words([Word(5, 10.0)])


def test_the_path_of_a_group_of_too_many_pieces_is_refused() -> None:
    circle = {**SPLIT["trajectory"], "radius_m": 0.1, "rate_rad_s": 500.0}  # type: ignore[dict-item]
    with pytest.raises(
        PtnsbcError, match=r"mission\.legs: the path of the leader or of a group takes more than"
    ):
        mission({**SPLIT, "trajectory": circle})
