"""docs/method.md: every equation of the paper has its row, every module and test named there exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
LAST_EQUATION = 54


def _table(columns: int) -> dict[str, list[str]]:
    """The rows of the table with so many columns, by their first cell."""
    section = PAGE.partition("## Equation by equation")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| (")]
    rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    return {row[0]: row[1:] for row in rows if len(row) == columns}


WHAT, WHERE = _table(4), _table(3)


def _equations(cell: str) -> set[int]:
    found: set[int] = set()
    for first, last in re.findall(r"\((\d+)\)(?:–\((\d+)\))?", cell):
        found |= set(range(int(first), int(last or first) + 1))
    return found


@pytest.mark.parametrize("table", [WHAT, WHERE], ids=["what", "where"])
def test_every_equation_of_the_paper_has_one_row(table):
    numbers = [number for cell in table for number in sorted(_equations(cell))]
    assert numbers == list(range(1, LAST_EQUATION + 1))


def test_a_deviation_has_a_reason():
    for equation, (printed, here, why) in WHAT.items():
        assert printed and here, equation
        assert why or here.startswith("as printed"), equation


@pytest.mark.parametrize(("equation", "where"), WHERE.items())
def test_modules_exist_and_so_do_tests(equation, where):
    modules, tests = where
    named = re.findall(r"`([\w/]+\.py)`", modules)
    assert named
    for name in named:
        assert (ROOT / name).is_file() or (ROOT / "ptnsbc_core" / name).is_file(), name
    known = {
        name
        for folder in ("core", "io", "sim", "tools")
        for path in (ROOT / "tests" / folder).rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    shown = set(re.findall(r"`(test_\w+)`", tests))
    assert shown and shown <= known, f"{equation}: {shown - known}"


def test_files_named_in_the_text_exist():
    for name in set(
        re.findall(r"`((?:ptnsbc_|tests/|scenarios/|docs/)[\w/]+\.(?:py|md|yaml))`", PAGE)
    ):
        assert (ROOT / name).is_file(), name
