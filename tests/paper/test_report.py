"""From parts to text: tables, claims, rounding."""

import math
import subprocess
from pathlib import Path

import pytest

from paper import report
from paper.experiment_result import (
    Claim,
    Column,
    ExperimentResult,
    Figure,
    Table,
    cell_text,
    rounded,
)
from paper.report import Origin, pages

ORIGIN = Origin("ptnsbc reproduce", "abc", "def", "seed 1")
TABLE = Table(
    "t",
    "A table",
    (Column("name"), Column("x, m", 3)),
    (("a", 1.23456), ("b", None)),
    "It means it.",
)
CLAIM = Claim("k", "It flies", "5 s", "4 s", "holds when soft", "Fig. 5")
PART = ExperimentResult(
    "one", "Part one", "Text.", (Figure("f1", "Fig. 1", "first", telling=True), Figure("f2", "Fig. 2", "second")),
    (TABLE,), (CLAIM,),
)  # fmt: skip


def test_cells() -> None:
    assert cell_text(1.23456, 3) == "1.235"
    assert cell_text(7) == "7"
    assert cell_text(None) == "–"
    assert cell_text("a | b") == "a | b"


def test_rounding_reaches_everywhere_and_keeps_integers() -> None:
    tree = {"a": [1.23456789, 2, (math.nan,)], "b": {"c": math.inf, "d": "x"}}
    assert rounded(tree) == {"a": [1.23457, 2, [None]], "b": {"c": None, "d": "x"}}


def test_claims_stand_on_one_page_and_tables_with_the_asked_for_figures_on_another() -> None:
    texts = pages(ORIGIN, [PART], images="img", all_figures=False)
    assert list(texts) == ["results", "tables"]
    claim = "| It flies | 5 s | 4 s | **holds when soft** | Fig. 5 |"
    assert claim in texts["results"] and claim not in texts["tables"]
    assert all("commit `abc`" in text for text in texts.values())
    text = texts["tables"]
    assert "| name | x, m |\n| --- | ---: |\n| a | 1.235 |\n| b | – |" in text
    assert "It means it." in text
    assert "(img/f1.png)" in text
    assert "(img/f2.png)" not in text
    assert "(img/f2.png)" in pages(ORIGIN, [PART], images="img", all_figures=True)["tables"]


def test_what_is_timed_says_so() -> None:
    timed = ExperimentResult("two", "Part two", "Text.", timed=True)
    assert "by the clock" in pages(ORIGIN, [timed], images="img", all_figures=True)["tables"]
    assert "by the clock" not in pages(ORIGIN, [PART], images="img", all_figures=True)["tables"]


def test_the_origin_is_that_of_this_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    here = Path(__file__).parents[2]
    git = ("git", "-C", str(here), "log", "-1", "--format=%H", "--", "ptnsbc_core")
    newest = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    assert report.commit(["ptnsbc_core"]).rstrip("+") == (newest[:12] or "unknown")
    digest = Origin.of("").digest
    monkeypatch.setattr(report, "_LAWS", ())
    assert Origin.of("").digest != digest
