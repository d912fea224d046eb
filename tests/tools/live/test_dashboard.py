"""The table in the terminal, at the widths of common terminals."""

from __future__ import annotations

import io
from typing import Any

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.console import recording
from ptnsbc_tools.live.dashboard import Dashboard, picture

SCENARIO = load_scenario("paper_5")


def uav(number: int, **more: Any) -> dict[str, Any]:
    near = {"name": "UAV 4", "distance": 1.33, "room": 0.7}
    base = {
        "id": number,
        "label": "",
        "lost": False,
        "mode": "form",
        "vehicle": None,
        "armed": None,
    }
    pose = [1.0, -20.25, 7.9, 0.0, 0.0, 0.0, 1.0]
    return (
        base
        | {"fix": None, "readiness": "ready", "battery": None}
        | {"pose": pose, "speed": 0.5, "error": 0.0123, "near": near}
        | more
    )


def frame(**more: Any) -> dict[str, Any]:
    base = {"t": 12.34, "leg": "form", "since_s": 12.34, "left_s": 1.25, "pace": 2.5, "over": False}
    base |= {"landing": ""}
    return base | {"uavs": [uav(i) for i in SCENARIO.uav_ids], "processes": []} | more


def text(shown: dict[str, Any], width: int) -> str:
    console = recording(io.StringIO(), width)
    console.print(picture(shown, SCENARIO, width))
    return console.export_text()


@pytest.mark.parametrize("width", [80, 100, 140])
def test_it_fits_and_keeps_its_numbers(width: int) -> None:
    battered = [uav(i, battery=81, vehicle="OFFBOARD", armed=True) for i in SCENARIO.uav_ids]
    for shown in (frame(), frame(uavs=battered)):
        found = text(shown, width)
        lines = found.splitlines()
        assert max(map(len, lines)) <= width
        assert found.count("0.0123") == found.count("1.33 uav4") == 5
        assert "deadline in 1.2 s" in found


def test_faults_and_the_lost_are_named() -> None:
    many = [{"name": f"uav{i}", "level": 1, "word": "w" * 200} for i in range(1, 8)]
    found = text(frame(processes=many, left_s=-2.0), 80)
    assert "and 2 more" in found and "deadline 2.0 s ago" in found
    assert max(map(len, found.splitlines())) <= 80
    assert "lost" in text(frame(uavs=[uav(1, lost=True, pose=None, error=None, near=None)]), 80)


def test_a_landing_is_no_catastrophe() -> None:
    close = {"error": None, "near": {"name": "UAV 4", "distance": 0.2, "room": -0.3}}
    shown = frame(
        leg="land", left_s=None, landing="landing, 3.7 m, 4 of 4",
        uavs=[uav(i, **close) for i in SCENARIO.uav_ids],
    )  # fmt: skip
    assert "landing, 3.7 m, 4 of 4" in text(shown, 80)
    console = recording(io.StringIO(), 80)
    console.print(picture(shown, SCENARIO, 80))
    assert "\x1b[31m" not in console.export_text(styles=True)  # red


def test_before_the_first_state() -> None:
    empty = {"pose": None, "speed": None, "error": None, "near": None, "mode": None}
    shown = frame(t=None, left_s=None, pace=None, leg="waiting", uavs=[uav(1, **empty)])
    assert "waiting" in text(shown, 80)


@pytest.mark.parametrize("width", [80, 100, 140])
def test_before_the_flight_it_is_a_health_board(width: int) -> None:
    known = {"vehicle": "OFFBOARD", "armed": False, "battery": 81, "fix": "RTK fixed"}
    ready = uav(
        2, label="red, Ada", readiness="ready to arm, waiting for the others", mode=None, **known
    )
    fault = uav(3, readiness="arming refused (not healthy: gps, prearm check)", mode=None)
    shown = text(frame(leg="waiting", uavs=[ready, fault, uav(4, readiness=None)]), width)
    assert max(map(len, shown.splitlines())) <= width
    words = " ".join(shown.replace("│", " ").split())
    for word in (
        "2 red, Ada",
        "RTK fixed",
        "OFFBOARD",
        "81",
        "ready to arm",
        "arming refused",
        "not heard",
    ):
        assert word in words
    assert "error" not in shown
    if width >= 100:
        assert "ready to arm, waiting for the others" in words


def test_lines_stay_above_and_the_pace_of_the_sim_is_left_out(capsys: Any) -> None:
    with Dashboard() as dashboard:
        dashboard.say("domain 3")
        dashboard.say("sim: 2.02 s, 101 steps/s")
        dashboard.sink(SCENARIO)(frame())
    said = capsys.readouterr().err
    assert "domain 3" in said and "steps/s" not in said
    assert "0.0123" in said
