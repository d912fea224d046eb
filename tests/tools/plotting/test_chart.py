"""One look of each UAV everywhere, and curves with fewer points."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.live.foxglove import FoxgloveSink
from ptnsbc_tools.live.watch import stage
from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.chart import COLOURS, DARK_COLOURS, Thinner, look, thin
from ptnsbc_tools.plotting.charts import charts, view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries
from ptnsbc_tools.report.page import uav_of


def hexadecimal(rgb: Any) -> str:
    return "#" + bytes(int(one) for one in rgb).hex().upper()


def in_charts(recording: Recording) -> list[dict[int, str]]:
    """Of every chart that has one curve for each UAV."""
    found = charts(view_of(recording, StatusSeries()))
    each = [[one for one in chart.curves if len(one.uavs) == 1] for chart in found]
    return [{one.uavs[0]: COLOURS[one.look.colour] for one in curves} for curves in each if curves]


def in_paths(recording: Recording) -> dict[int, str]:
    axes = draw.blank_figure((4, 4)).add_subplot()
    draw.draw_paths(axes, recording)
    named = [line for line in axes.lines if str(line.get_label()).startswith("UAV ")]
    return {int(str(line.get_label()).split()[1]): str(line.get_color()) for line in named}


def in_foxglove(scenario: Scenario) -> dict[int, str]:
    """Messages that the sink draws, as namespaces of their fields, without its server."""

    class Kinds:
        def __getattr__(self, _: str) -> Any:
            return SimpleNamespace

    sink = FoxgloveSink.__new__(FoxgloveSink)
    sink._scenario, sink._kinds = scenario, Kinds()
    found = {}
    for uav in scenario.uav_ids:
        drawn: Any = sink._uav({"id": uav, "pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]})
        colour = drawn.spheres[0].color
        found[uav] = hexadecimal(np.rint([255 * colour.r, 255 * colour.g, 255 * colour.b]))
    return found


def test_a_uav_has_the_same_colour_everywhere(fly: Callable[..., Recording]) -> None:
    recording = fly(seconds=7.0)
    scenario = recording.scenario
    wanted = {uav: COLOURS[look(row).colour] for row, uav in enumerate(scenario.uav_ids)}
    assert len(set(wanted.values())) == len(wanted) == 5
    drawn = in_charts(recording)
    assert len(drawn) > 3 and all(one.items() <= wanted.items() for one in drawn)
    assert drawn[0] == wanted
    assert in_paths(recording) == wanted
    assert in_foxglove(scenario) == wanted
    page = stage(scenario)
    assert page["colours"] == {"light": COLOURS, "dark": DARK_COLOURS}
    assert {one["id"]: COLOURS[one["colour"]] for one in page["space"]["uavs"]} == wanted
    assert {uav: COLOURS[uav_of(scenario, uav)["colour"]] for uav in wanted} == wanted


def test_the_dark_palette_has_a_colour_for_each_light_one() -> None:
    assert len(set(DARK_COLOURS)) == len(set(COLOURS)) == len(COLOURS)


CURVES = arrays(
    np.float64,
    st.integers(2, 400),
    elements=st.floats(-1e3, 1e3) | st.just(float("nan")),
)


@given(CURVES, st.integers(8, 60))
def test_ends_peaks_and_gaps_stay(values, points):
    t = np.arange(values.size, dtype=np.float64)
    kept = thin(t, values, points)
    assert kept.t.size == kept.values.size <= max(points, 8)
    assert (kept.t[0], kept.t[-1]) == (0, values.size - 1)
    assert (np.diff(kept.t) > 0).all()
    np.testing.assert_array_equal(values[kept.t.astype(int)], kept.values)
    if np.isfinite(values).any():
        assert np.nanmax(kept.values) == np.nanmax(values)
        assert np.nanmin(kept.values) == np.nanmin(values)
    assert np.isnan(kept.values).any() == np.isnan(values).any()


def test_a_needle_keeps_its_height_and_its_time():
    t = np.linspace(0, 60, 6001)
    values = np.zeros(6001)
    values[1234] = 7.0
    kept = thin(t, values, 200)
    assert kept.values.max() == 7.0
    assert kept.t[kept.values.argmax()] == t[1234]


def test_what_is_short_is_left_alone():
    t, values = np.arange(5.0), np.arange(5.0)
    assert thin(t, values, 8).t is t


@given(CURVES, st.integers(8, 60), st.data())
def test_in_pieces_as_at_once(values, points, data):
    t = np.arange(values.size, dtype=np.float64)
    cuts = sorted(data.draw(st.lists(st.integers(0, values.size), max_size=6)))
    thinner = Thinner(values.size, points)
    for begin, end in zip([0, *cuts], [*cuts, values.size], strict=True):
        thinner.add(t[begin:end], values[begin:end])
    whole = thin(t, values, points)
    np.testing.assert_array_equal(thinner.points().t, whole.t)
    np.testing.assert_array_equal(thinner.points().values, whole.values)
