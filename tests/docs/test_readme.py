"""The README: its verdict is what a flight prints, and the index leads to every page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ptnsbc_tools.cli import app

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_verdict_is_that_of_the_flight():
    """`make demo` flies the same: a fleet in lock-step and one process give the same verdict."""
    (shown,) = re.findall(
        r"^Verdict: .*?(?=^```$)", (ROOT / "README.md").read_text("utf-8"), re.M | re.S
    )
    printed = CliRunner().invoke(app, ["simulate", "paper_5"]).stdout
    assert shown.split() == printed.partition("\n\n")[0].split()


def test_the_index_leads_to_every_page():
    docs = ROOT / "docs"
    index = (docs / "README.md").read_text("utf-8")
    pages = {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")} - {"README.md"}
    assert pages == set(re.findall(r"\]\(((?:notes/)?\w+\.md)\)", index))
