"""The report from Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import ptnsbc
from ptnsbc_tools.library.reporting import ReportError

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


def test_a_report_names_its_page_and_the_verdict(tmp_path: Path) -> None:
    made = ptnsbc.report(SAMPLE, tmp_path / "page", pictures=False, progress=False)
    assert (made.page, made.pictures) == (tmp_path / "page" / "index.html", ())
    assert made.page.stat().st_size > 100_000
    assert (made.verdict, made.problem) == (ptnsbc.read_bag(SAMPLE).verdict.verdict, "")


def test_a_bag_that_is_not_there_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="none: no such bag"):
        ptnsbc.report(tmp_path / "none")
    assert list(tmp_path.iterdir()) == []


def test_a_flight_has_the_page_of_its_bag(tmp_path: Path) -> None:
    flight = ptnsbc.read_bag(SAMPLE)
    quiet = {"pictures": False, "progress": False}
    made = ptnsbc.report(flight, tmp_path / "flight", other=flight, **quiet)
    read = ptnsbc.report(SAMPLE, tmp_path / "bag", other=SAMPLE, **quiet)
    assert made.page.read_bytes() == read.page.read_bytes()


def test_a_flight_without_a_bag_has_its_page_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flight = replace(ptnsbc.read_bag(SAMPLE), bag=None)
    made = ptnsbc.report(flight, pictures=False, progress=False)
    assert made.page == Path("paper_5_free-report", "index.html")
    assert "headless" in made.page.read_text("utf-8")
