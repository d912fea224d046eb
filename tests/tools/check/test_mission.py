"""What the check says of the legs of a mission."""

from typing import Any

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check.mission import legs, words
from ptnsbc_tools.check.trajectory import trajectory


def odd(*more: dict[str, Any], seconds: float = 60.0) -> list[tuple[str, str]]:
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
    assert odd(go_to(50.0, 10.0)) == [("error", "mission.legs[1]")]
    assert odd(go_to(50.0, 20.0)) == []


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
    assert odd(go_to(5.0, 10.0), seconds=12.0) == [("warning", "timing.duration_s")]


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
