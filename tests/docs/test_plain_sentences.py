"""Pages, help texts and docstrings have plain sentences, whose subject is a thing and no clause.

"Who has the recorder waits" is none. A docstring begins with a noun or a verb, not with "Whether" or "How".
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import click
import pytest
from markdown_it import MarkdownIt

from tests.support.commands import every_command

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_VERB = r"(?:is|are|was|were|has|have|comes|counts|goes|stays|wins)"
# Up to a full stop or a semicolon: a question is not meant, and a label ("What a UAV reports.") has one verb only.
_CLAUSE = re.compile(
    rf"(?:^|[.;:] )((?:(?:Who|Whoever) [a-z]|What [a-z]+ [^.;:?,]+? {_VERB}\b)[^.;:?]*[.;](?=\s|$))"
)

SOURCES = sorted(
    path
    for folder in (*ROOT.glob("ptnsbc*"), *map(ROOT.joinpath, ("bench", "docs", "examples")))
    for path in folder.rglob("*.py")
)
_QUESTION = re.compile(r"(?:Wh(?:at|en|ere|ether|ich|o|oever|om|ose|y)|How)\b")


def riddles(text: str) -> list[str]:
    """Sentences whose subject is a clause."""
    return _CLAUSE.findall(" ".join(text.split()))


def _texts(page: Path) -> Iterator[str]:
    """The paragraphs and cells of a page, code replaced by a dash."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))
    for before, token in pairwise(tokens):
        if token.type == "inline" and before.type != "heading_open":
            parts = (
                {"code_inline": "—", "softbreak": " ", "hardbreak": " "}.get(
                    child.type, child.content
                )
                for child in token.children or ()
            )
            yield "".join(parts)


def test_no_sentence_of_a_page_begins_with_a_clause():
    texts = [(page.name, text) for page in PAGES for text in _texts(page)]
    assert [(page, found) for page, text in texts for found in riddles(text)] == []


def _helps(command: click.Command, name: str) -> Iterator[tuple[str, str]]:
    yield name, command.help or ""
    for parameter in command.params:
        yield f"{name} {parameter.name}", getattr(parameter, "help", None) or ""
    for word, below in getattr(command, "commands", {}).items():
        yield from _helps(below, f"{name} {word}")


def test_no_sentence_of_a_help_begins_with_a_clause():
    helps = _helps(every_command(), "ptnsbc")
    assert [(name, found) for name, text in helps for found in riddles(text)] == []


def docstrings(node: ast.AST, name: str) -> Iterator[tuple[str, str]]:
    """The docstrings of a module, class or function, of what is public in it, and of its attributes."""
    body = [one for one in getattr(node, "body", ()) if isinstance(one, ast.stmt)]
    for line in body:
        value = line.value if isinstance(line, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield f"{name}:{line.lineno}", value.value
    for below in body:
        word = getattr(below, "name", "")
        if word.startswith("__") or not word.startswith("_"):
            yield from docstrings(below, name)


def test_no_docstring_begins_with_a_clause():
    found = [
        (where, text)
        for path in SOURCES
        for where, text in docstrings(
            ast.parse(path.read_text("utf-8")), str(path.relative_to(ROOT))
        )
        if _QUESTION.match(text)
    ]
    assert found == []


def test_docstrings_of_what_is_public_count():
    source = '''
"""How a module begins."""
LIMIT = 3
"""Which limit."""
class Public:
    """Why a class is there."""
    def __init__(self):
        self.flag = True
        """Whether it is set."""
    def _own(self):
        """Whose method."""
'''
    found = [text for _, text in docstrings(ast.parse(source), "m") if _QUESTION.match(text)]
    assert [text.split()[0] for text in found] == ["How", "Which", "Why", "Whether"]


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("Who has the recorder waits for all, and ends.", 1),
        ("It is named. What does not exist is null.", 1),
        ("Who is late?", 0),
        ("What differs between them", 0),
        ("What surrounds the UAVs.", 0),
        ("What it prints, and when:", 0),
        ("The host that runs the recorder waits for all.", 0),
    ],
)
def test_what_counts(text, count):
    assert len(riddles(text)) == count
