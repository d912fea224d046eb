"""The README: its table is what a flight prints, and the index leads to every page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ptnsbc_tools.cli import app

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_table_is_that_of_the_flight():
    """`make demo` flies the same: a fleet in lock-step and one process give the same verdict."""
    shown = re.findall(r"^[│┃].*[│┃]$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    assert len(shown) == 6
    printed = CliRunner().invoke(app, ["simulate", "paper_5"]).stdout
    lines = {line.rstrip() for line in printed.splitlines()}
    assert set(shown) <= lines


def test_the_index_leads_to_every_page():
    index = (ROOT / "docs" / "README.md").read_text("utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages == set(re.findall(r"\]\((\w+\.md)\)", index))
