"""The README: its verdict is what `make demo` prints, and the index leads to every page."""

from __future__ import annotations

import re
from pathlib import Path

from docs.make import tutorial
from docs.make.markdown import region

ROOT = Path(__file__).parents[2]


def test_the_verdict_is_that_of_the_demo():
    (shown,) = re.findall(
        r"^Verdict: .*?(?=^```$)", (ROOT / "README.md").read_text("utf-8"), re.M | re.S
    )
    _, printed = region(tutorial.PAGE.read_text("utf-8"), tutorial.DEMO).split("$ ptnsbc demo\n")
    assert shown.split() == printed.partition("\n\n")[0].split()


def test_the_index_leads_to_every_page():
    docs = ROOT / "docs"
    index = (docs / "README.md").read_text("utf-8")
    pages = {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")} - {"README.md"}
    assert pages == set(re.findall(r"\]\(((?:notes/)?\w+\.md)\)", index))
