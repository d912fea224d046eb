"""Figures and pictures: the same flight gives the same bytes, and every leg is drawn."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib.axes
import numpy as np
import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import OutputFileError
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.charts import Mark, errors, view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries


@pytest.mark.parametrize(
    ("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_the_same_bytes_twice(fly, tmp_path, suffix, start):
    contents = set()
    for name in ("a", "b"):
        chart = errors(view_of(fly(seconds=7.0), StatusSeries()))
        path = draw.save(draw.figure_of(chart, "paper_5_free"), tmp_path / name / f"e{suffix}")
        contents.add(path.read_bytes())
    (content,) = contents
    assert content.startswith(start)
    assert sorted(one.name for one in (tmp_path / "a").iterdir()) == [f"e{suffix}"]


def test_other_suffixes_and_places_are_refused(fly, tmp_path):
    figure = draw.figure_of(errors(view_of(fly(seconds=7.0), StatusSeries())), "x")
    with pytest.raises(PtnsbcError, match=r"suffix \.gif: expected \.png, \.svg or \.pdf"):
        draw.save(figure, tmp_path / "e.gif")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFileError, match="cannot be written"):
        draw.save(figure, tmp_path / "file" / "e.png")


@pytest.mark.parametrize("columns", [None, "one", "two"])
def test_a_pdf_has_fonts_that_journals_take_and_the_width_of_their_columns(fly, tmp_path, columns):
    chart = errors(view_of(fly(seconds=7.0), StatusSeries()))
    with draw.sized(columns):
        figure = draw.figure_of(chart, "x", columns)
        [path] = draw.save_pages([figure], tmp_path / "e.pdf")
    assert b"/Type3" not in path.read_bytes()
    if columns is not None:
        assert figure.get_figwidth() == draw.COLUMNS_IN[columns]
        assert figure.axes[0].get_title() == ""


@pytest.mark.parametrize("legend", [True, False])
@pytest.mark.parametrize("columns", [None, "one"])
def test_the_labels_of_small_axes_stand_in_the_figure(fly, columns, legend):
    """Also the longest one, which is broken into lines; a size of 10 points is that of Matplotlib."""
    view = view_of(fly(seconds=7.0), StatusSeries())
    for chart in (view.chart("errors"), view.chart("between")):
        with draw.sized(columns):
            figure = draw.blank_figure((3.5, 2.2))
            axes = figure.add_subplot()
            draw.draw_chart(axes, chart, legend=legend)
            figure.draw_without_rendering()
        label = axes.yaxis.label.get_window_extent()
        assert label.y0 >= -1.0 and label.y1 <= figure.bbox.height + 1.0
        assert label.x0 >= 0.0


def test_words_at_times_close_together_stand_side_by_side(fly):
    """Also the one at the end of the flight, and in the figure."""
    chart = errors(view_of(fly(seconds=12.0), StatusSeries()))
    times = {"deadline 5 s": 5.0, "gate": 5.3, "hold due": 11.5, "land": 11.9}
    chart = replace(chart, limits=(), marks=tuple(Mark(t, name) for name, t in times.items()))
    with draw.sized("one"):
        figure = draw.figure_of(chart, "x", "one")
        figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == 4 and not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert max(box.x1 for box in boxes) <= figure.bbox.width + 1.0


def test_no_name_covers_a_curve_or_another_name(fly):
    """The legend stands below the axes, and names in the picture from above stand apart."""
    recording = fly(scenario=load_scenario("paper_5", {"timing.duration_s": 12.0}))
    figure = draw.blank_figure((6, 6))
    axes = figure.add_subplot()
    draw.draw_paths(axes, recording)
    figure.draw_without_rendering()
    assert axes.get_legend().get_window_extent().y1 < axes.get_window_extent().y0
    boxes = [text.get_window_extent() for text in axes.texts]
    assert {"0 s", "5 s", "12 s"} <= {text.get_text() for text in axes.texts}
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def test_an_obstacle_beside_what_flies_is_named(fly):
    """In axes that are wider than the paths; what is outside of them has no name."""
    beside = {"kind": "box", "size_m": [2, 2, 6], "keep_out_m": 0.5}
    boxes = [
        {"name": name, "position_m": [x, 3, 3], **beside}
        for name, x in (("house", 9.0), ("tower", 90.0))
    ]
    scenario = load_scenario("paper_5_free", {"timing.duration_s": 7.0, "world.obstacles": boxes})
    axes = draw.blank_figure((16, 4)).add_subplot()
    draw.draw_paths(axes, fly(scenario=scenario, seconds=7.0))
    names = {text.get_text() for text in axes.texts}
    assert "house" in names and "tower" not in names


def test_a_user_leaves_out_legend_and_labels(fly):
    chart = errors(view_of(fly(seconds=7.0), StatusSeries()))
    axes = draw.blank_figure((3.5, 2.2)).add_subplot()
    draw.draw_chart(axes, chart, legend=False, labels=False)
    assert axes.get_legend() is None and not axes.texts


LEGS = ((0, "form"), (12 * 10**9, "form"))


@pytest.fixture
def drawn(monkeypatch):
    """Curves by their label, as they are drawn."""
    curves: dict[str, list[np.ndarray]] = {}
    plot = matplotlib.axes.Axes.plot

    def noted(self: Any, x: Any, y: Any, *rest: Any, label: str = "", **look: Any) -> Any:
        curves.setdefault(label, []).append(np.stack(np.broadcast_arrays(x, y)))
        return plot(self, x, y, *rest, label=label, **look)

    monkeypatch.setattr(matplotlib.axes.Axes, "plot", noted)
    return curves


def test_every_leg_is_drawn(fly, drawn, tmp_path: Path) -> None:
    away = {2: lambda t: np.where(t > 12.0, 3.0, 0.0)}
    recording = fly(away, seconds=20.0, epochs=LEGS)
    path = draw.draw_flight(view_of(recording, StatusSeries(), 0.07), tmp_path / "flight.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    error, from_above, _ = drawn["UAV 2"]
    assert from_above[0].max() - from_above[0].min() > 3.0
    assert error[0].max() == pytest.approx(19.99)
    assert np.nanmax(error[1][error[0] > 12.0]) == pytest.approx(3.0)
    assert np.nanmax(error[1][error[0] < 12.0]) < 0.01


def test_a_long_path_is_thinned(fly, drawn, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("ptnsbc_tools.plotting.draw._PATH_POINTS", 100)
    draw.draw_flight(view_of(fly(), StatusSeries()), tmp_path / "flight.png")
    assert drawn["UAV 2"][1].shape == (2, 100)
