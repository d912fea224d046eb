"""Checks of what happens in flight: trajectory, legs, UAVs that come and go, faults."""

from __future__ import annotations

from typing import Any

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check import check
from ptnsbc_tools.check.finding import Finding
from ptnsbc_tools.check.mission import legs, membership, trajectory, words


def odd_of_legs(*more: dict[str, Any], seconds: float = 60.0) -> list[tuple[str, str]]:
    changes = {
        "mission": {"legs": [{"kind": "form", "over_s": 6}, *more]},
        "timing.duration_s": seconds,
    }
    found = legs(load_scenario("paper_5_free", changes))
    return [(one.severity, one.key) for one in found if one.severity != "info"]


def go_to(metres: float, seconds: float) -> dict[str, Any]:
    return {"kind": "go_to", "position_m": [metres, 5, 10], "over_s": seconds}


def test_the_shipped_mission_passes() -> None:
    found = list(legs(load_scenario("mission_6")))
    assert [one.severity for one in found] == ["info"] * 5


def test_a_leg_that_asks_for_more_than_the_vehicle_has_is_refused() -> None:
    """35/16 of 50 m in 10 s are 10.9 m/s, of 8 m/s; in 20 s they are 5.5 m/s."""
    assert odd_of_legs(go_to(50.0, 10.0)) == [("error", "mission.legs[1]")]
    assert odd_of_legs(go_to(50.0, 20.0)) == []


def test_a_take_off_is_checked_as_a_leg() -> None:
    """35/16 of 40 m in 8 s are 10.9 m/s, of 8 m/s; the ground counts from the end of it."""
    assert [one.severity for one in legs(load_scenario("take_off_4"))] == ["info"] * 5
    steep = load_scenario(
        "take_off_4", {"mission.legs[0].height_m": 40, "mission.legs[0].over_s": 8}
    )
    assert [one.key for one in legs(steep) if one.severity == "error"] == ["mission.legs[0]"]
    low = load_scenario("take_off_4", {"mission.legs[0].height_m": 0})
    assert not [one for one in trajectory(load_scenario("take_off_4")) if one.severity == "error"]
    assert "the ground" in next(one.limit for one in trajectory(low) if one.severity == "error")


def test_a_landing_needs_the_time_to_come_down() -> None:
    """The line of mission_6 lands from 6 m at 0.5 m/s."""
    (landing,) = [one for one in legs(load_scenario("mission_6")) if "land" in one.value]
    assert landing.limit.startswith(">= 12.00 s")
    short = load_scenario("mission_6", {"mission.legs[5].over_s": 11.9})
    assert [one.key for one in legs(short) if one.severity == "error"] == ["mission.legs[5]"]
    assert list(legs(load_scenario("mission_6", {"mission.legs[5].ground_m": 0.5})))


def test_a_flight_that_ends_before_its_legs_is_warned_of() -> None:
    assert odd_of_legs(go_to(5.0, 10.0), seconds=12.0) == [("warning", "timing.duration_s")]


def waiting(*more: dict[str, Any]) -> list[tuple[str, str, str]]:
    changes = {"mission": {"legs": [{"kind": "form", "over_s": 6}, *more]}}
    found = words(load_scenario("split_join", changes))
    return [(one.severity, one.key, one.value.partition(" leaves")[0]) for one in found]


def test_legs_that_wait_for_a_word_are_checked_as_if_it_were_said_at_once() -> None:
    """35/16 of 50 m in 10 s are too fast, and a fifth of the shape is within the keep-out of two UAVs."""
    gate, home = {**go_to(50.0, 10.0), "on": "word", "name": "gate"}, go_to(0.0, 20.0)
    narrow = {"kind": "change", "scale": [0.2, 0.2, 1], "over_s": 5, "on": "word"}
    assert waiting(home) == []
    assert waiting({**gate, "over_s": 20}, {**home, "name": "home"}) == [
        ("info", "mission.legs[1].on", "gate waits for a word"),
        ("info", "mission.legs[1]", "said at once, gate"),
        ("info", "mission.legs[2]", "said at once, home"),
    ]
    found = [one for one in waiting(gate, narrow) if one[0] != "info"]
    assert found[0] == ("warning", "mission.legs[1]", "said at once, gate")
    assert found[1][2].startswith("said at once, the places of UAV")


POINTS = [[0, 0, 8], [6, 0, 8], [6, 6, 8]]


def found(**changes: Any) -> list[Finding]:
    overrides = {key.replace("__", "."): value for key, value in changes.items()}
    return list(trajectory(load_scenario("paper_5_free", overrides)))


def odd_of_trajectory(**changes: Any) -> list[tuple[str, str]]:
    return [(one.severity, one.key) for one in found(**changes) if one.severity != "info"]


def path(**keys: Any) -> dict[str, Any]:
    return {"kind": "waypoints", "points_m": POINTS, "times_s": [0, 20, 40], **keys}


def test_shipped_trajectories_pass() -> None:
    assert odd_of_trajectory() == []
    shipped = load_scenario("waypoints_5")
    assert [one for one in trajectory(shipped) if one.severity != "info"] == []


def test_says_how_fast_it_is() -> None:
    """A circle of 5 m at 0.1 rad/s: 0.5 m/s, 0.05 m/s^2, 0.005 m/s^3."""
    assert found()[0].value == "at most 0.5 m/s, 0.05 m/s^2, 0.005 m/s^3"


def test_a_path_below_the_ground_is_refused() -> None:
    low = [[0, 0, 8], [6, 0, -1], [6, 6, 8]]
    (error,) = [
        one for one in found(leader__trajectory=path(points_m=low)) if one.severity == "error"
    ]
    assert error.key == "leader.trajectory"
    assert " comes down to -1." in error.value


def test_a_place_below_the_ground_is_refused_too() -> None:
    assert odd_of_trajectory(**{"formation__offsets_m__4": [0.6, -1.2, -9]}) == [
        ("error", "leader.trajectory")
    ]


@pytest.mark.parametrize(
    ("fence", "outside"),
    [
        ({"radius_m": 9.0}, False),
        ({"radius_m": 5.5}, True),
        ({"box_min_m": [-9, -9, 0], "box_max_m": [9, 9, 9]}, False),
        ({"box_min_m": [-9, -9, 0], "box_max_m": [9, 9, 7]}, True),
    ],
)
def test_the_fence_holds_every_place(fence: dict[str, Any], outside: bool) -> None:
    assert odd_of_trajectory(mavlink__geofence=fence) == (
        [("error", "mavlink.geofence")] if outside else []
    )


def test_a_jerk_that_no_tilt_can_follow_is_named() -> None:
    rough = path(times_s=[0, 1.2, 2.4])
    assert ("warning", "leader.trajectory") in odd_of_trajectory(leader__trajectory=rough)


def test_a_path_that_rests_has_no_heading() -> None:
    assert odd_of_trajectory(leader__trajectory=path(heading="path")) == [
        ("error", "leader.trajectory.heading")
    ]


def test_a_file_that_ends_in_motion() -> None:
    rows = "0,0,5,8\n10,5,5,8\n20,10,5,8\n"
    csv = {"kind": "file", "samples": rows}
    assert odd_of_trajectory(leader__trajectory=csv) == [("warning", "leader.trajectory")]
    assert odd_of_trajectory(leader__trajectory=csv, timing__duration_s=19) == []


LEADER, JOINER, LEAVER = 0, 6, 5  # places in `uavs` of relay


def odd_of_members(**changes: Any) -> list[tuple[str, str, str]]:
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    found = membership(load_scenario("relay", keys))
    return [(one.severity, one.key, one.value) for one in found if one.severity != "info"]


def test_the_shipped_relay_passes_and_its_joiner_has_time() -> None:
    """It needs at least what its way back takes: the verdict says 20.74 s, by the velocity of its place too."""
    (joins,) = membership(load_scenario("relay"))
    assert (joins.severity, joins.key) == ("info", "uavs[6].joins_s")
    needed_s = float(joins.value.rpartition("until ")[2].removesuffix(" s"))
    assert 14.0 < needed_s <= 20.74


def test_a_formation_in_which_nobody_comes_or_goes_has_no_such_finding() -> None:
    assert list(membership(load_scenario("paper_5"))) == []


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("uavs[6].joins_s", 60, "60 s: UAV 7 never joins"),
        ("uavs[5].leaves_s", 50, "50 s: UAV 6 never leaves"),
    ],
)
def test_times_after_the_flight_are_warned_of(key: str, value: float, words: str) -> None:
    assert odd_of_members(**{key: value}) == [("warning", key, words)]


@pytest.mark.parametrize("changes", [{"joins_s": 48}, {"joins_s": 14, "leaves_s": 16}])
def test_a_joiner_without_the_time_to_its_place_is_warned_of(changes: dict[str, float]) -> None:
    ((severity, key, value),) = odd_of_members(
        **{f"uavs[6].{name}": value for name, value in changes.items()}
    )
    assert (severity, key) == ("warning", "uavs[6].joins_s")
    assert "from its place then, and needs until" in value


def test_a_leader_that_leaves_without_a_successor_is_refused() -> None:
    leaves = {"uavs[0].leaves_s": 20, "faults": []}
    said = "from 20 s on nobody leads: all hold"
    assert odd_of_members(**leaves, leader__successors=[]) == [
        ("error", "leader.successors", f"[]: {said}"),
    ]
    assert odd_of_members(**leaves) == []


def test_a_leader_that_is_killed_without_a_successor_is_warned_of() -> None:
    """Lost 0.5 s later, after `communication.stale_s`: the scenario may want to show it."""
    stale_s = load_scenario("relay").communication.stale_s
    assert odd_of_members(leader__successors=[]) == [
        ("warning", "leader.successors", f"[]: from {36 + stale_s:g} s on nobody leads: all hold")
    ]


def test_a_successor_that_has_left_before_cannot_take_over() -> None:
    """Without the other one nobody leads, from when the leader is lost."""
    gone = {"uavs[1].leaves_s": 10}
    stale_s = load_scenario("relay").communication.stale_s
    idle = f"UAV 2 is away then, when the lead is free at {36 + stale_s:g} s"
    assert odd_of_members(**gone) == [("warning", "leader.successors[0]", idle)]
    assert [one[:2] for one in odd_of_members(**gone, leader__successors=[2])] == [
        ("warning", "leader.successors[0]"),
        ("warning", "leader.successors"),
    ]


def test_the_last_successor_that_leaves_is_refused() -> None:
    """The leader leaves at 20 s, and the one that took over at 30 s."""
    both = {"uavs[0].leaves_s": 20, "uavs[1].leaves_s": 30, "faults": []}
    ((severity, key, value),) = odd_of_members(**both, leader__successors=[2])
    assert (severity, key) == ("error", "leader.successors")
    assert "from 30 s on nobody leads" in value


def test_one_that_comes_back_is_no_successor() -> None:
    """UAV 5 is restarted at 22 s, and was away for longer than `communication.stale_s`."""
    ((severity, key, value),) = odd_of_members(leader__successors=[5, 2])
    assert (severity, key) == ("warning", "leader.successors[0]")
    assert value.startswith("UAV 5 was away before")


def test_nobody_moves_up_in_a_tree_without_lines() -> None:
    star = {uav: 1 for uav in range(2, 8)}
    flat = {"formation__vacancy": "close_up", "communication__tree": star}
    assert [one[:2] for one in odd_of_members(**flat)] == [("warning", "formation.vacancy")]
    assert odd_of_members(formation__vacancy="close_up") == []


def said_of(**fault):
    scenario = load_scenario("paper_5", {"faults": [{"at_s": 1, **fault}]})
    found = [one for one in check(scenario) if one.key.startswith("faults[0]")]
    return [(one.severity, one.advice) for one in found]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"kind": "silence", "uav": 2}, []),
        ({"kind": "kill", "process": "uav2"}, []),
        ({"kind": "kill", "process": "sim"}, [("info", "only in real time")]),
        ({"kind": "disk_full"}, [("info", "only in real time")]),
        ({"kind": "freeze", "uav": 2, "duration_s": 1}, [("info", "only in real time")]),
    ],
)
def test_where_a_fault_is_injected(fault, said):
    assert said_of(**fault) == said


def test_a_fault_after_the_flight_is_a_warning():
    assert said_of(kind="silence", uav=2, at_s=1e6)[0][0] == "warning"
