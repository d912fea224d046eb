"""What pages get, and in which order."""

from __future__ import annotations

import json
import threading
from typing import Any

from ptnsbc_tools.live.feed import MOST_ROWS, Feed


def frame(t: float | None, error: float | None = 0.5) -> dict[str, Any]:
    return {"t": t, "uavs": [{"pose": [0.0] * 7, "error": error}]}


def test_a_page_begins_with_the_flight_so_far() -> None:
    feed = Feed()
    feed.set_stage({"name": "a"})
    for tick in range(10):
        feed.add(frame(tick / 4))
    number, version, text = feed.begin()
    message = json.loads(text)
    assert message["stage"] == {"name": "a"} and len(message["rows"]) == 10
    assert feed.after(number, version, 0.0) == (number, [])
    feed.add(frame(9.0))
    found = feed.after(number, version, 0.0)
    assert found is not None and [json.loads(one)["t"] for one in found[1]] == [9.0]


def test_frames_that_lack_a_uav_or_come_too_fast_are_no_rows() -> None:
    feed = Feed()
    for t in (None, 0.0, 0.01, 0.02, 0.2):
        feed.add(frame(t))
    feed.add({"t": 1.0, "uavs": [{"pose": None, "error": None}]})
    assert [row[0] for row in json.loads(feed.begin()[2])["rows"]] == [0.0, 0.2]


def test_a_long_flight_is_thinned() -> None:
    feed = Feed()
    for tick in range(2 * MOST_ROWS):
        feed.add(frame(tick * 0.125))
    times = [row[0] for row in json.loads(feed.begin()[2])["rows"]]
    assert len(times) <= MOST_ROWS
    assert times[0] == 0.0 and times[-1] > 0.99 * 2 * MOST_ROWS * 0.125


def test_a_new_stage_makes_pages_begin_anew_and_answers_are_passed_on() -> None:
    feed = Feed()
    number, version, _ = feed.begin()
    feed.answer("hold: announced")
    found = feed.after(number, version, 0.0)
    assert found is not None and json.loads(found[1][0])["text"] == "hold: announced"
    feed.set_stage({"name": "b"})
    assert feed.after(found[0], version, 0.0) is None


def test_whoever_waits_is_woken() -> None:
    feed = Feed()
    number, version, _ = feed.begin()
    adder = threading.Timer(0.01, feed.add, [frame(1.0)])
    adder.start()
    found = feed.after(number, version, 30.0)
    adder.join()
    assert found is not None and len(found[1]) == 1
