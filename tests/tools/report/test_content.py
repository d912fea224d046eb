"""What the page's script is given."""

from __future__ import annotations

import base64
import gzip
import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.build import places_beside_leader
from ptnsbc_sim.swarm import fly as fly_headless
from ptnsbc_sim.verdict import Series
from ptnsbc_sim.verdict.headless import recording_of
from ptnsbc_tools.plotting.flight import view_of
from ptnsbc_tools.reading.diagnostics import StatusSeries
from ptnsbc_tools.report.content import Pack, content

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
        replace(recording, odometry={**recording.odometry, 2: Series(series.t_ns, values)})
    )
    np.testing.assert_array_equal(np.sign(found.poses()[:, 1, 6]), 1)


def test_encounters_and_legs(fly, count):
    active = count(12.0, active=lambda t: np.clip(t - 7.0, 0.0, 1.0))
    recording = fly(epochs=((0, "form"), (9 * SECOND, "hold"), (99 * SECOND, "land")))
    recording = replace(recording, counters={**recording.counters, 4: active})
    space = Unpacked(recording).space
    ((begin, end),) = space["uavs"][3]["avoiding"]
    assert (begin, end) == (pytest.approx(7.0), pytest.approx(8.0))
    assert space["legs"] == [[9.0, "hold"]]


def test_a_deadlock_is_told(fly, count):
    counters = count(12.0)
    values = counters.values.copy()
    values[:, COUNTERS.index("deadlock_s")] = np.clip(counters.t_ns * 1e-9 - 7.0, 0.0, 1.0)
    recording = fly()
    stuck = {**recording.counters, 4: Series(counters.t_ns, values)}
    uavs = Unpacked(replace(recording, counters=stuck)).space["uavs"]
    assert [uav["deadlocks"] for uav in uavs if uav["id"] != 4] == [[]] * 4
    ((begin, end),) = uavs[3]["deadlocks"]
    assert (begin, end) == (pytest.approx(7.0), pytest.approx(8.0))


def test_a_long_flight_of_many_stays_small(fly, monkeypatch):
    monkeypatch.setattr("ptnsbc_tools.report.content._MOST_POSES", 500)
    monkeypatch.setattr("ptnsbc_tools.report.content._MOST_POINTS", 2000)
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
