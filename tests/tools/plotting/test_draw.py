"""Pictures: the same flight, the same bytes."""

from __future__ import annotations

import pytest

from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.flight import shown
from ptnsbc_tools.plotting.space import errors
from ptnsbc_tools.plotting.status import StatusSeries


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml")])
def test_the_same_bytes_twice(fly, tmp_path, suffix, start):
    contents = set()
    for name in ("a", "b"):
        chart = errors(shown(fly(seconds=7.0), StatusSeries()))
        path = draw.save(draw.figure_of(chart, "paper_5_free"), tmp_path / name / f"e{suffix}")
        contents.add(path.read_bytes())
    (content,) = contents
    assert content.startswith(start)
    assert sorted(one.name for one in (tmp_path / "a").iterdir()) == [f"e{suffix}"]


def test_other_suffixes_and_places_are_refused(fly, tmp_path):
    figure = draw.figure_of(errors(shown(fly(seconds=7.0), StatusSeries())), "x")
    with pytest.raises(draw.FigureError, match=r"suffix \.pdf: expected \.png or \.svg"):
        draw.save(figure, tmp_path / "e.pdf")
    (tmp_path / "file").write_text("")
    with pytest.raises(draw.FigureError, match="cannot be written"):
        draw.save(figure, tmp_path / "file" / "e.png")
