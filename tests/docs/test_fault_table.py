"""The table of faults: every row is complete, and every test that it names is there."""

import ast
from functools import cache
from pathlib import Path

from docs.make.fault_table import ALL, ANSWERS

ROOT = Path(__file__).parents[2]


@cache
def functions(file: str) -> set[str]:
    body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    return {one.name for one in body if isinstance(one, ast.FunctionDef)}


def test_every_row_is_complete_and_its_tests_exist():
    for row in ANSWERS:
        assert all(row), row
        assert set(row.where) <= set(ALL), row
        for test in row.tests:
            file, _, name = test.partition("::")
            assert name in functions(file), test


def test_no_fault_stands_twice():
    assert len({row.fault for row in ANSWERS}) == len(ANSWERS)
