"""The report from Python."""

from __future__ import annotations

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
