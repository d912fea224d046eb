"""The public names: each is there, is documented, and is in docs/library.md."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import pytest

import ptnsbc
from tests.support.commands import every_command

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "library.md"


def test_every_public_name_is_there_and_documented() -> None:
    for name in ptnsbc.__all__:
        assert inspect.getdoc(getattr(ptnsbc, name)), name


def test_the_page_names_all_of_them() -> None:
    text = PAGE.read_text("utf-8")
    known = set(re.findall(r"`(?:ptnsbc\.)?([A-Za-z_]+)[`(.]", text))
    assert set(ptnsbc.__all__) <= known


def test_the_page_has_the_quantities() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    shown = {name: (unit, axes) for name, unit, axes in rows}
    for one in ptnsbc.QUANTITIES:
        assert shown[one.name] == (one.unit, ", ".join(one.axes))


def test_the_findings_of_the_doctor_are_those_of_the_command() -> None:
    found = ptnsbc.doctor()
    assert all(isinstance(one, ptnsbc.Finding) for one in found)
    assert {one.key for one in found} >= {"platform", "cores", "clock"}


def test_each_command_has_its_call_or_a_reason() -> None:
    text = PAGE.read_text("utf-8")
    rows = dict(re.findall(r"^\| `ptnsbc ([a-z]+)` \| (.+) \|$", text, re.MULTILINE))
    assert rows.keys() == every_command().commands.keys()
    for command, cell in rows.items():
        if cell.startswith("none: "):
            continue
        calls = re.findall(r"`(\w+)(?:\.(\w+))?`", cell.partition(";")[0])
        assert calls, command
        for name, method in calls:
            assert name in ptnsbc.__all__, (command, name)
            assert not method or hasattr(getattr(ptnsbc, name), method), (command, method)


_BELOW = ("ptnsbc_core", "ptnsbc_io", "ptnsbc_sim", "ptnsbc_tools/library", "ptnsbc_tools/reading")


@pytest.mark.parametrize("folder", [*_BELOW, "ptnsbc_tools/check", "ptnsbc_tools/plotting"])
def test_errors_of_the_library_name_no_option_of_a_command(folder: str) -> None:
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Raise):
                texts = [one.value for one in ast.walk(node) if isinstance(one, ast.Constant)]
                if '--set "' in texts:  # `set_keys` reads this option, for the commands alone
                    continue
                found = [text for text in texts if re.search(r"(^|\s|\()--[a-z]", str(text))]
                assert not found, f"{path}:{node.lineno}"
