"""docs/method.md: every equation of the paper has its row, every module and test named there exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
LAST_EQUATION = 54


def _rows() -> list[list[str]]:
    section = PAGE.partition("## Equation by equation")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| (")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def _equations(cell: str) -> set[int]:
    found: set[int] = set()
    for first, last in re.findall(r"\((\d+)\)(?:–\((\d+)\))?", cell):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def test_every_equation_of_the_paper_has_one_row():
    numbers = [number for row in _rows() for number in sorted(_equations(row[0]))]
    assert numbers == list(range(1, LAST_EQUATION + 1))


def test_every_row_says_where_and_how_it_is_tested():
    for row in _rows():
        assert len(row) == 6, row[0]
        assert row[1] and row[2] and row[4] and row[5], row[0]
        assert row[3] or row[2].startswith("as printed"), f"{row[0]}: a deviation without a reason"


@pytest.mark.parametrize("row", _rows(), ids=lambda row: row[0])
def test_modules_exist_and_so_do_tests(row):
    for name in re.findall(r"`([\w/]+\.py)`", row[4]):
        assert (ROOT / name).is_file() or (ROOT / "ptnsbc_core" / name).is_file(), name
    known = {
        name
        for folder in ("core", "sim", "tools")
        for path in (ROOT / "tests" / folder).rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    named = set(re.findall(r"`(test_\w+)`", row[5]))
    assert named and named <= known, named - known


def test_files_named_in_the_text_exist():
    for name in set(
        re.findall(r"`((?:ptnsbc_|tests/|scenarios/|docs/)[\w/]+\.(?:py|md|yaml))`", PAGE)
    ):
        assert (ROOT / name).is_file(), name
