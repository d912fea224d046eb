"""Figures: legends beside the curves, the width of a column, the same bytes every time."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from paper.figures import formation, inputs, paths, style
from paper.flights import JudgedFlight, fly_judged
from paper.output import ExperimentFolder

DRAWINGS = {
    "3d": lambda output, flights: paths.in_space(output, flights["paper"], 5, "in space"),
    "xy": lambda output, flights: paths.from_above(output, flights["paper"], 6, "from above"),
    "distance": lambda output, flights: formation.distances(output, flights, 9, ""),
    "angle": lambda output, flights: formation.angles(output, flights, 11, ""),
    "input": lambda output, flights: inputs.whole_flight(output, flights, 15, ""),
    "first": lambda output, flights: inputs.first_second(output, flights, 17, ""),
    "tall": lambda output, flights: paths.in_space(
        output, fly_judged("experiment_4", {"seed": 1}), 33, "in space"
    ),
    "energy": lambda output, flights: inputs.energy(output, flights),
    "swarm": lambda output, flights: formation.distance_errors(output, flights, 26),
    "five": lambda output, flights: inputs.five_uavs(output, flights, 28, (1, 2, 3, 4, 5)),
}


@lru_cache
def flights() -> dict[str, JudgedFlight]:
    common = {"plant.kind": "rigid_body_6dof", "timing.duration_s": 8.0}
    return {
        name: fly_judged("paper_5", {**common, "gains.profile": name}) for name in ("paper", "soft")
    }


@pytest.mark.slow
def test_no_legend_covers_a_panel(tmp_path: Path, monkeypatch) -> None:
    kept = []
    monkeypatch.setattr(style, "save", lambda made, folder, name: kept.append((name, made)))
    output = ExperimentFolder(tmp_path, lambda line: None)
    with style.applied():
        for draw in DRAWINGS.values():
            draw(output, flights())
        for name, made in kept:
            made.canvas.draw()
            assert made.get_figwidth() * 25.4 == style.COLUMN_MM
            boxes = [axes.get_window_extent() for axes in made.axes]
            assert all(_inside(label, made.bbox) for label in _labels(made)), name
            for legend in made.legends:
                found = legend.get_window_extent()
                assert not any(found.overlaps(box) for box in boxes), name
                assert found.x0 >= 0 and found.x1 <= made.bbox.x1, name
    assert len(kept) == len(DRAWINGS)


def _labels(made) -> list:
    """The names of all axes of a figure."""
    found = [axis.label for axes in made.axes for axis in axes._axis_map.values()]
    return [label for label in [*found, made._supxlabel, made._supylabel] if label is not None]


def _inside(label, page) -> bool:
    box = label.get_window_extent()
    return not label.get_text() or (
        box.x0 >= 0 and box.y0 >= 0 and box.x1 <= page.x1 and box.y1 <= page.y1
    )


def test_the_same_bytes_twice(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        with style.applied():
            formation.leader_yaw(
                ExperimentFolder(tmp_path / folder, lambda line: None), flights(), 13, ""
            )
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert {path.suffix for path in files} == {".png", ".svg", ".csv"}
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()


def test_a_sheet_holds_what_is_drawn(tmp_path: Path) -> None:
    columns = {
        "time_s": np.array([0.0, 0.01]),
        "x, told_m": np.array([1.0, np.nan]),
        "y_m": np.array([3.0]),
    }
    ExperimentFolder(tmp_path, lambda line: None).write_curves("sheet", columns)
    assert (
        tmp_path / "curves" / "sheet.csv"
    ).read_text() == "time_s,x_told_m,y_m\n0,1,3\n0.01,nan,\n"
