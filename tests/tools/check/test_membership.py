"""What the check says of UAVs that come and go."""

from typing import Any

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check.membership import membership

LEADER, JOINER, LEAVER = 0, 6, 5  # places in `uavs` of relay


def odd(**changes: Any) -> list[tuple[str, str, str]]:
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
    assert odd(**{key: value}) == [("warning", key, words)]


@pytest.mark.parametrize("changes", [{"joins_s": 48}, {"joins_s": 14, "leaves_s": 16}])
def test_a_joiner_without_the_time_to_its_place_is_warned_of(changes: dict[str, float]) -> None:
    ((severity, key, value),) = odd(**{f"uavs[6].{name}": value for name, value in changes.items()})
    assert (severity, key) == ("warning", "uavs[6].joins_s")
    assert "from its place then, and needs until" in value


def test_a_leader_that_leaves_without_a_successor_is_refused() -> None:
    leaves = {"uavs[0].leaves_s": 20, "faults": []}
    said = "from 20 s on nobody leads: all hold"
    assert odd(**leaves, leader__successors=[]) == [
        ("error", "leader.successors", f"[]: {said}"),
    ]
    assert odd(**leaves) == []


def test_a_leader_that_is_killed_without_a_successor_is_warned_of() -> None:
    """Lost 0.5 s later, after `communication.stale_s`: the scenario may want to show it."""
    stale_s = load_scenario("relay").communication.stale_s
    assert odd(leader__successors=[]) == [
        ("warning", "leader.successors", f"[]: from {36 + stale_s:g} s on nobody leads: all hold")
    ]


def test_a_successor_that_has_left_before_cannot_take_over() -> None:
    """Without the other one nobody leads, from when the leader is lost."""
    gone = {"uavs[1].leaves_s": 10}
    stale_s = load_scenario("relay").communication.stale_s
    idle = f"UAV 2 is away then, when the lead is free at {36 + stale_s:g} s"
    assert odd(**gone) == [("warning", "leader.successors[0]", idle)]
    assert [one[:2] for one in odd(**gone, leader__successors=[2])] == [
        ("warning", "leader.successors[0]"),
        ("warning", "leader.successors"),
    ]


def test_the_last_successor_that_leaves_is_refused() -> None:
    """The leader leaves at 20 s, and the one that took over at 30 s."""
    both = {"uavs[0].leaves_s": 20, "uavs[1].leaves_s": 30, "faults": []}
    ((severity, key, value),) = odd(**both, leader__successors=[2])
    assert (severity, key) == ("error", "leader.successors")
    assert "from 30 s on nobody leads" in value


def test_one_that_comes_back_is_no_successor() -> None:
    """UAV 5 is restarted at 22 s, and was away for longer than `communication.stale_s`."""
    ((severity, key, value),) = odd(leader__successors=[5, 2])
    assert (severity, key) == ("warning", "leader.successors[0]")
    assert value.startswith("UAV 5 was away before")


def test_nobody_moves_up_in_a_tree_without_lines() -> None:
    star = {uav: 1 for uav in range(2, 8)}
    flat = {"formation__vacancy": "close_up", "communication__tree": star}
    assert [one[:2] for one in odd(**flat)] == [("warning", "formation.vacancy")]
    assert odd(formation__vacancy="close_up") == []
