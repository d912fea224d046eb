"""docs/equations.md: every equation of the paper has its rows, every module and test named there exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
LAST_EQUATION = 54


def _table(columns: int) -> dict[str, list[str]]:
    """The rows of the table with so many columns, by their first cell."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| (")]
    rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    return {row[0]: row[1:] for row in rows if len(row) == columns}


WHAT, WHERE = _table(4), _table(3)


def _equations(cell: str) -> set[int]:
    numbers: set[int] = set()
    for first, last in re.findall(r"\((\d+)\)(?:–\((\d+)\))?", cell):
        numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


@pytest.mark.parametrize("table", [WHAT, WHERE], ids=["what", "where"])
def test_every_equation_of_the_paper_has_one_row(table):
    numbers = [number for cell in table for number in sorted(_equations(cell))]
    assert numbers == list(range(1, LAST_EQUATION + 1))


def test_a_deviation_has_a_reason():
    for equation, (printed, here, why) in WHAT.items():
        assert printed and here, equation
        assert why or here.startswith("as printed"), equation


def test_every_equation_names_its_modules_and_tests():
    for equation, (modules, tests) in WHERE.items():
        assert re.findall(r"`([\w/]+\.py)`", modules), equation
        assert re.findall(r"`test_\w+`", tests), equation
