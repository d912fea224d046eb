"""The process of a viewer, and the stage of its page."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from chromium import chromium

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.live.server import ORDERS, Feed, LiveServer, live_page
from ptnsbc_tools.live.watch import stage


def test_it_is_json_and_has_every_uav_and_obstacle() -> None:
    scenario = load_scenario("paper_5")
    found = json.loads(json.dumps(stage(scenario), allow_nan=False))
    space = found["space"]
    assert [uav["id"] for uav in space["uavs"]] == list(scenario.uav_ids)
    assert len(space["obstacles"]) == len(scenario.world.bodies)
    assert len(found["starts"]) == len(scenario.uav_ids)
    low, high = map(np.array, space["bounds"])
    path = np.array(space["path"]).reshape(-1, 3)
    assert (low <= path).all() and (path <= high).all()


SCENARIO = load_scenario("paper_5")


def frame(leg: str) -> dict[str, Any]:
    uavs = [
        {
            "id": uav,
            "pose": [*SCENARIO.uav(uav).position.tolist(), 0.0, 0.0, 0.0, 1.0],
            "error": 0.5,
        }
        for uav in SCENARIO.uav_ids
    ]
    more = {
        "label": "",
        "beside": None,
        "speed": 0.0,
        "near": None,
        "mode": leg,
        "lost": False,
        "vehicle": None,
    }
    uavs = [{**uav, **more, "armed": None, "battery": None} for uav in uavs]
    here = {
        "t": 1.0,
        "since_s": 1.0,
        "left_s": 4.0,
        "pace": 1.0,
        "over": False,
        "processes": [],
        "landing": "",
    }
    return {**here, "leg": leg, "uavs": uavs}


@pytest.fixture
def feed() -> Feed:
    one = Feed()
    one.set_stage(stage(SCENARIO))
    return one


@pytest.fixture
def server(feed: Feed) -> Iterator[LiveServer]:
    with LiveServer(feed, live_page) as one:
        yield one


@pytest.fixture
def page(server: LiveServer, feed: Feed) -> Iterator[Any]:
    with chromium() as browser:
        page = browser.new_page()
        page.set_default_timeout(60_000)
        page.goto(server.address)
        page.wait_for_selector("html[data-ready=true]")
        feed.add(frame("form"))
        page.wait_for_selector("[data-order=hold]:enabled")
        yield page


@pytest.mark.slow
def test_every_order_is_asked_sent_and_answered(page: Any, server: LiveServer, feed: Feed) -> None:
    words = {"hold": "Hold", "land": "End flight", "stop": "LAND ALL", "motors": "STOP ALL MOTORS"}
    assert words.keys() == set(ORDERS)  # the last two are those of the emergency card
    for order in ORDERS:
        button, dialog = page.locator(f"[data-order={order}]"), page.locator("#confirm")
        button.click()
        assert page.locator("#asked").inner_text().endswith(f"{words[order]}?")
        assert button.inner_text() == words[order]
        dialog.get_by_role("button", name="Cancel").click()
        assert server.orders.empty()
        button.click()
        dialog.get_by_role("button", name="Yes").click()
        assert server.orders.get(timeout=60) == order
        feed.tell("said", text=f"{order}: done")
        page.wait_for_function(
            "(text) => document.querySelector('#notice').textContent === text", arg=f"{order}: done"
        )
    assert server.orders.empty()


@pytest.mark.slow
def test_before_the_flight_only_stop_can_be_given_and_the_board_says_what_is_awaited(
    page: Any, feed: Feed
) -> None:
    cells = page.locator("#board tr:first-child td.before")
    assert not any(cell.is_visible() for cell in cells.all())
    waiting = frame("waiting")
    waiting["uavs"][0] |= {"fix": "RTK fixed", "readiness": "waiting for the mode"}
    feed.add(waiting)
    page.wait_for_selector("[data-order=hold]:disabled")
    assert page.locator("[data-order=land]").is_disabled()
    assert page.locator("[data-order=stop]").is_enabled()
    assert cells.all_inner_texts() == ["RTK fixed", "waiting for the mode"]
    assert all(cell.is_visible() for cell in cells.all())
    assert not page.locator("#board tr:first-child td.flying").first.is_visible()
    assert page.locator("#board tr:nth-child(2) td.before").last.inner_text() == "not heard"


@pytest.mark.parametrize(
    ("refusal", "said"),
    [(None, "hold: the leader has announced it"), ("no leader", "hold: no leader")],
)
def test_hold_is_a_call_to_the_fleet(refusal: str | None, said: str) -> None:
    pytest.importorskip("rclpy")
    from ptnsbc_tools.live.watch import _obey

    called: list[str] = []

    def call(order: str) -> str | None:
        called.append(order)
        return refusal

    observer: Any = SimpleNamespace(call=call)
    assert _obey("hold", observer, 7, "") == said
    assert called == ["hold"]


def test_stop_is_the_command_and_says_what_it_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    from ptnsbc_tools.live import watch

    ran: list[list[str]] = []

    def run(command: list[str], **_: Any) -> Any:
        ran.append(command)
        if len(ran) > 1:
            raise subprocess.TimeoutExpired(command, 30.0)
        return SimpleNamespace(stderr="uav1: lands\nuav2: lands\n")

    monkeypatch.setattr(subprocess, "run", run)
    observer: Any = None
    assert watch._obey("stop", observer, 7, "/blue") == "stop: uav1: lands; uav2: lands"
    assert watch._obey("motors", observer, 7, "/blue") == "stop --kill: no answer in 30 s"
    command, fleet = (
        [sys.executable, "-m", "ptnsbc_tools"],
        ["--domain", "7", "--namespace", "/blue"],
    )
    assert ran == [[*command, "stop", *fleet], [*command, "stop", "--kill", *fleet]]


@pytest.mark.slow
def test_a_landing_is_no_catastrophe_and_the_page_ends_with_the_verdict(
    page: Any, server: LiveServer, feed: Feed
) -> None:
    landing = frame("land") | {"left_s": None, "landing": "landing, 3.7 m, 4 of 5"}
    for uav in landing["uavs"]:
        uav |= {"error": None, "speed": 0.4, "vehicle": "LAND"}
    feed.add(landing)
    page.wait_for_selector("#state.plain")
    assert page.locator("#countdown").inner_text() == "landing, 3.7 m, 4 of 5"
    assert page.locator("#line").inner_text().startswith("All UAVs land")
    assert page.locator("#board tr:first-child td.mode").inner_text() == "land, LAND"
    feed.tell("end", verdict="met late", line="3 of 5 in place by 5 s.")
    feed.tell("report", page="<title>the report</title>", path="/tmp/flight-report/index.html")
    feed.add(landing)  # one that is late
    server.__exit__()  # the fleet has ended, and the page stays
    page.wait_for_selector("html[data-connected=false]")
    assert page.locator("#countdown").inner_text() == "met late"
    assert page.locator("#line").inner_text() == "3 of 5 in place by 5 s."
    assert "/tmp/flight-report/index.html" in page.locator("#report").inner_text()
    assert page.locator("[data-order=motors]").is_disabled()


def test_the_last_word_goes_to_pages_that_are_open_or_come_later() -> None:
    pytest.importorskip("rclpy")
    from ptnsbc_tools.live.watch import show_end

    feed = Feed()
    feed.set_stage(stage(SCENARIO))
    number, version, _ = feed.begin()
    sample = str(Path(__file__).parents[3] / "bags" / "sample")
    show_end(feed, {"verdict": "met", "line": "x", "bag": sample, "kept": False}, reported=False)
    for begun in (number, feed.begin()[0]):
        found = feed.after(begun, version, 0.0)
        assert found is not None and json.loads(found[1][0])["verdict"] == "met"
