"""A UAV has one colour wherever it is drawn: figures, report, live page, Foxglove, Rerun."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.live.foxglove import FoxgloveSink
from ptnsbc_tools.live.stage import stage
from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.chart import COLOURS, DARK_COLOURS, look
from ptnsbc_tools.plotting.charts import charts
from ptnsbc_tools.plotting.flight import view_of
from ptnsbc_tools.reading.diagnostics import StatusSeries
from ptnsbc_tools.report.content import uav_of


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
