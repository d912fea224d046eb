"""The figures and the page of a sweep."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from ptnsbc_tools.sweeps.summary import read_sweep
from ptnsbc_tools.sweeps.sweep_report import START_ERROR, drawn_axes, figures, grouped, write_report


def test_few_values_are_groups_of_their_own() -> None:
    axis = grouped("m", np.array([1.0, 2.0, 1.0, 2.0, 1.0, 4.0, 4.0, 4.0, 1.0]))
    assert axis is not None
    assert axis.labels == ("1", "2", "4")
    assert axis.group.tolist() == [0, 1, 0, 1, 0, 2, 2, 2, 0]
    assert not axis.words


def test_a_range_is_put_into_bins_of_the_same_size() -> None:
    values = np.random.default_rng(1).uniform(0.0, 1.0, 100)
    axis = grouped("x", values)
    assert axis is not None
    sizes = np.bincount(axis.group)
    assert len(sizes) == 8
    assert sizes.max() - sizes.min() <= 1
    assert (np.diff(axis.centres) > 0).all()


def test_words_are_groups_and_one_value_is_none() -> None:
    axis = grouped("tree", np.array(["star", "chain", "star"]))
    assert axis is not None
    assert (axis.labels, axis.words) == (("chain", "star"), True)
    assert grouped("x", np.ones(5)) is None
    assert grouped("x", np.array([1.0, np.nan, 2.0])) is None


def test_a_sweep_has_a_figure_for_each_axis_a_map_and_distributions(flown: Path) -> None:
    sweep = read_sweep(flown)
    names = [axis.name for axis in drawn_axes(sweep)]
    assert names[0] == "plant.mass_kg [kg]"
    assert names[-1] == START_ERROR
    shown = [name for name, _, _ in figures(sweep)]
    assert shown[-1] == "distributions"
    assert "map-1" in shown
    assert sum(name.startswith("success") for name in shown) == len(names)


def test_the_page_holds_tables_commands_and_pictures(flown: Path, tmp_path: Path) -> None:
    folder = tmp_path / "small"
    shutil.copytree(flown, folder)
    page = write_report(read_sweep(folder))
    text = page.read_text(encoding="utf-8")
    assert page == folder / "report" / "index.html"
    assert "Flights met: " in text
    assert f"ptnsbc simulate --sweep {folder} --draw " in text
    pictures = sorted(page.parent.glob("*.png"))
    assert text.count("data:image/png;base64,") == len(pictures) >= 4
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    assert not list(page.parent.glob(".*"))
    assert write_report(read_sweep(folder)).read_text(encoding="utf-8") == text
