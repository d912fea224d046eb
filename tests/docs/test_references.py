"""What the pages name is there: tests, files and Python modules."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
_TEST = re.compile(r"(tests/[\w/]+\.py)::(\w+)")
_TEST_NAME = re.compile(r"^test_\w*[a-z0-9]$")  # those that end with _ stand for several
_FILE = re.compile(r"(?:[\w.-]+/)+[\w.-]+\.py\b")
_MODULE = re.compile(r"^\w+\.py$")
_LAWS = ("method.md", "equations.md")  # name modules of the core without its folder
_DOTTED = re.compile(r"\b(?:ptnsbc_[a-z]+|bench)(?:\.\w+)+")
_FILES_BELOW = ("", "ptnsbc_core")
_GONE = ("CHANGELOG.md",)  # names what was there


@cache
def _spans(page: Path) -> tuple[str, ...]:
    """What stands in backticks on a page."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))
    children = (child for token in tokens for child in token.children or ())
    return tuple(child.content for child in children if child.type == "code_inline")


def _named(page: Path, pattern: re.Pattern[str]) -> set[str]:
    """What stands in backticks on a page and matches."""
    return {found for span in _spans(page) for found in pattern.findall(span)}


def test_tests_that_are_named_exist():
    missing = [
        f"{page.name}: {file}::{name}"
        for page in PAGES
        for file, name in _TEST.findall(page.read_text(encoding="utf-8"))
        if not re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert missing == []


def test_tests_that_are_named_without_a_file_exist():
    written = {
        name
        for path in (ROOT / "tests").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", path.read_text("utf-8"), re.MULTILINE)
    }
    named = {(page.name, name) for page in PAGES for name in _named(page, _TEST_NAME)}
    assert [row for row in sorted(named) if row[1] not in written] == []


def test_files_that_are_named_exist():
    missing = {
        (page.name, name)
        for page in PAGES
        for name in _named(page, _FILE) | (_named(page, _MODULE) if page.name in _LAWS else set())
        if not any((ROOT / below / name).is_file() for below in _FILES_BELOW)
    }
    assert {row for row in missing if row[0] not in _GONE} == set()


def test_modules_that_are_named_exist():
    named = {(page.name, name) for page in PAGES for name in _named(page, _DOTTED)}
    assert {row for row in named if row[0] not in _GONE and not _exists(row[1])} == set()


def _exists(name: str) -> bool:
    """Whether a dotted name is a package, a module, or a name at the top of one (of a class: its first part)."""
    place, parts = ROOT, name.split(".")
    while parts and (place / parts[0]).is_dir():
        place /= parts.pop(0)
    if not parts:
        return (place / "__init__.py").is_file()
    module = place / f"{parts[0]}.py"
    if module.is_file():
        parts.pop(0)
    else:
        module = place / "__init__.py"
    return not parts or parts[0] in _top_names(module)


@cache
def _top_names(module: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.parse(module.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def test_a_dotted_name_is_looked_up():
    assert _exists("ptnsbc_core.step.step") and _exists("paper.baselines.fly")
    assert _exists("ptnsbc_core.tasks") and _exists("ptnsbc_core.types.Array")
    assert not _exists("ptnsbc_core.step.stop") and not _exists("ptnsbc_core.nothing")
