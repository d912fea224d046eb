"""The page of a report, and the pack of its data."""

from __future__ import annotations

import base64
import gzip
import json
import re
import struct
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.table import Table
from rich.text import Text

from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.mission.legs import CANCEL, Word
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.swarm import fly as fly_headless
from ptnsbc_sim.verdict import Track
from ptnsbc_sim.verdict.recording import recording_of
from ptnsbc_tools.plotting.charts import view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries
from ptnsbc_tools.report.page import Pack, content, html_table, page

SECOND = 10**9


class Unpacked:
    """The text, and the arrays it points to."""

    def __init__(self, recording) -> None:
        data = gzip.decompress(base64.b64decode(content(view_of(recording, StatusSeries()))))
        (size,) = struct.unpack_from("<I", data)
        self.text = json.loads(data[4 : 4 + size])
        self.space = self.text["space"]
        self._floats = np.frombuffer(data, "<f4", offset=4 + size)

    def array(self, reference):
        offset, length = reference
        return self._floats[offset : offset + length]

    def poses(self):
        return self.array(self.space["poses"]).reshape(-1, len(self.space["uavs"]), 7)


def test_places_and_attitudes_over_time(fly):
    recording = fly({3: lambda t: np.exp(-t)})
    found = Unpacked(recording)
    t, poses = found.array(found.space["t"]), found.poses()
    assert (t[0], t[-1]) == (0, pytest.approx(11.99))
    assert np.diff(t).max() <= 1 / 25 + 1e-4
    own = recording.odometry[3]
    for axis in range(3):
        expected = np.interp(t, own.t_ns * 1e-9, own.values[:, axis])
        np.testing.assert_allclose(poses[:, 2, axis], expected, atol=1e-5)
    np.testing.assert_array_equal(poses[:, :, 6], 1)


def test_the_tree_and_the_places_in_it(fly):
    recording = fly()
    uavs = Unpacked(recording).space["uavs"]
    assert [uav["parent"] for uav in uavs] == [None, 1, 2, 3, 4]
    assert [uav["leader"] for uav in uavs] == [True, False, False, False, False]
    assert uavs[1]["offset"] == recording.scenario.offset(2).tolist()
    assert uavs[1]["places"] is None


@pytest.mark.slow
def test_places_of_a_shape_that_moves():
    scenario = load_scenario("figure_eight", {"timing.duration_s": 2.0})
    found = Unpacked(recording_of(fly_headless(scenario)))
    uavs, t = found.space["uavs"], found.array(found.space["t"])
    assert uavs[0]["places"] is None
    places = found.array(uavs[3]["places"]).reshape(-1, 3)
    np.testing.assert_allclose(places, places_beside_leader(scenario, 4, t), atol=1e-6)


def test_a_quaternion_that_changes_sign_is_no_turn(fly):
    recording = fly()
    series = recording.odometry[2]
    values = series.values.copy()
    values[600:, 3:7] *= -1
    found = Unpacked(
        replace(recording, odometry={**recording.odometry, 2: Track(series.t_ns, values)})
    )
    np.testing.assert_array_equal(np.sign(found.poses()[:, 1, 6]), 1)


def test_encounters_and_legs(fly, count):
    active = count(12.0, active=lambda t: np.clip(t - 7.0, 0.0, 1.0))
    recording = fly(epochs=((0, "form"), (9 * SECOND, "hold"), (99 * SECOND, "land")))
    recording = replace(recording, counters={**recording.counters, 4: active})
    space = Unpacked(recording).space
    ((begin, end),) = space["uavs"][3]["avoiding"]
    assert (begin, end) == (pytest.approx(7.0), pytest.approx(8.0))
    assert space["marks"] == [[5.0, "deadline 5 s"], [9.0, "hold"]]


def test_a_deadlock_is_told(fly, count):
    counters = count(12.0)
    values = counters.values.copy()
    values[:, COUNTERS.index("deadlock_s")] = np.clip(counters.t_ns * 1e-9 - 7.0, 0.0, 1.0)
    recording = fly()
    stuck = {**recording.counters, 4: Track(counters.t_ns, values)}
    uavs = Unpacked(replace(recording, counters=stuck)).space["uavs"]
    assert [uav["deadlocks"] for uav in uavs if uav["id"] != 4] == [[]] * 4
    ((begin, end),) = uavs[3]["deadlocks"]
    assert (begin, end) == (pytest.approx(7.0), pytest.approx(8.0))


def test_a_long_flight_of_many_stays_small(fly, monkeypatch):
    monkeypatch.setattr("ptnsbc_tools.report.page._MOST_POSES", 500)
    monkeypatch.setattr("ptnsbc_tools.report.page._MOST_POINTS", 2000)
    found = Unpacked(fly())
    assert found.poses().shape == (100, 5, 7)
    sizes = [len(found.array(c["t"])) for chart in found.text["charts"] for c in chart["curves"]]
    assert max(sizes) <= max(2000 // len(sizes), 50)


def test_text_and_arrays_come_back():
    pack = Pack()
    first = pack.add(np.arange(6.0).reshape(2, 3))
    second = pack.add(np.array([np.nan, -1.5]))
    data = gzip.decompress(base64.b64decode(pack.encode({"name": "café", "at": second})))
    (size,) = struct.unpack_from("<I", data)
    assert json.loads(data[4 : 4 + size]) == {"name": "café", "at": [6, 2]}
    assert size % 4 == 0  # the floats behind it must be aligned
    floats = np.frombuffer(data, "<f4", offset=4 + size)
    assert first == [0, 6]
    np.testing.assert_array_equal(floats[:6], np.arange(6.0))
    np.testing.assert_array_equal(floats[6:], np.float32([np.nan, -1.5]))


@pytest.fixture(autouse=True)
def _light_plotly(monkeypatch):
    """The library is the same every time; without it the tests are quick."""
    monkeypatch.setattr("ptnsbc_tools.report.page.plotly", lambda: "")


def made(recording, **about):
    return page(view_of(recording, StatusSeries()), about)


class _Text(HTMLParser):
    """What a reader without script sees."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self._skipping = ""

    def handle_starttag(self, tag, attrs):
        if tag in ("script", "style"):
            self._skipping = tag

    def handle_endtag(self, tag):
        if tag == self._skipping:
            self._skipping = ""

    def handle_data(self, data):
        if not self._skipping:
            self.words.append(data)


def text(html: str) -> str:
    parser = _Text()
    parser.feed(html)
    return " ".join(" ".join(parser.words).split())


def test_the_verdict_is_on_top_and_plain(fly):
    read = text(made(fly(), mode="headless"))
    assert read.index("Flight report") < read.index("5 of 5") < read.index("Deadline, UAV by UAV")
    assert "flown headless" in read
    assert "Input" in read
    assert "Separation" in read


def test_a_miss_says_why(fly):
    html = made(fly({3: lambda t: 0.5 + 0 * t}))
    assert '<section class="verdict missed"' in html
    assert "UAV 3 missed: outside 0.050 m until the end" in text(html)


def test_no_verdict_says_why_and_shows_the_rest(fly):
    recording = fly()
    odometry = {uav: series for uav, series in recording.odometry.items() if uav != 3}
    html = made(replace(recording, odometry=odometry))
    assert '<section class="verdict none"' in html
    assert "No verdict: no message on /uav3/odom" in text(html)


def test_every_leg_has_its_table(fly):
    legs = ((0, "form"), (6 * 10**9, "form"))
    away = {2: lambda t: np.where(t > 6.0, 0.3, 0.0)}
    read = text(made(fly(away, epochs=legs)))
    assert "Leg 1, from 0.00 s: met" in read
    assert "Leg 2, from 6.00 s: missed" in read
    assert "leg 2 from 6.00 s, UAV 2 missed" in read


def test_every_leg_of_a_mission_has_its_row(fly):
    """One leg begins by its time, one on a word, and a word cuts the second one short."""
    legs = [
        {"kind": "form", "over_s": 5},
        {"kind": "hold", "name": "utc", "over_s": 1, "at": "2026-11-22T12:00:06Z"},
        {"kind": "hold", "name": "gate", "over_s": 2, "on": "word"},
    ]
    mission = {"mission": {"start": "2026-11-22T12:00:00Z", "legs": legs}}
    recording = fly()
    said = load_scenario("paper_5_free", mission).with_words((Word(3, 7.5), Word(CANCEL, 8.25)))
    read = text(made(replace(recording, scenario=said)))
    assert "Legs of the mission" in read
    assert re.search(r"utc hold \w+ 6\.00 7\.00", read)
    assert "gate hold cut short 7.50 9.50 - -" in read
    assert "leg gate cut short: by an operator" in read


def test_nothing_points_outside(fly):
    html = made(fly())
    outside = set(re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}[^\s\"'<]*", html))
    assert outside == set()
    assert "default-src 'none'" in html
    assert not re.search(r"<(link|img|iframe|object)\b|\bsrc=", html)


def test_the_same_flight_gives_the_same_page(fly):
    errors = {2: lambda t: np.exp(-t)}
    assert made(fly(errors)) == made(fly(errors))


def test_names_cannot_break_the_page(fly):
    flown = view_of(fly(), StatusSeries())
    html = page(
        replace(flown, verdict=None, problem="no </script> here & there"), {"<b>": "</pre>"}
    )
    assert "<b>:" not in html
    assert "no </script> here & there" in text(html)
    assert html.count("</script>") == 3


def test_a_flight_without_any_odometry(fly):
    recording = replace(fly(), odometry={}, wrench={}, counters={})
    assert "No verdict" in text(made(recording))


def test_numbers_that_are_none_leave_a_page(fly):
    recording = fly()
    for uav in (1, 4):
        recording.odometry[uav].values[:5, :3] = np.nan
        recording.wrench[uav].values[700:] = np.nan
    html = made(recording)
    assert '<section class="verdict missed"' in html
    assert "state not finite from t = 0.00 s" in text(html)


def test_one_message_is_no_flight(fly):
    recording = fly()
    first = {uav: Track(s.t_ns[:1], s.values[:1]) for uav, s in recording.odometry.items()}
    assert "No verdict: the recording holds no formation flight" in text(
        made(replace(recording, odometry=first))
    )


def test_tables_follow_the_command_line():
    table = Table(title="Separation")
    table.add_column("pair")
    table.add_column("closest m", justify="right")
    table.add_row("uav1 - <O1>", "0.4", style="bold red")
    table.add_row(Text("met"), "2.0")
    html = html_table(table)
    assert '<tr class="bad"><td class="text">uav1 - &lt;O1&gt;</td><td class="number">0.4' in html
    assert '<span class="word met">met</span>' in html
    assert "<caption>Separation</caption>" in html
