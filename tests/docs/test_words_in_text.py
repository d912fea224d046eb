"""Commands that the text of a page mentions, between backticks: each exists, and takes the options it is given."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

import pytest
import typer.main
from markdown_it import MarkdownIt

from paper.command import app as paper_app
from ptnsbc_nodes.fleet.child_process import EXECUTABLES
from tests.support.commands import every_command

ROOT = Path(__file__).parents[2]
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
COMMANDS = every_command()


def _spans(page: Path) -> Iterator[str]:
    """Everything between backticks, and every line of a block of commands."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))
    for token in tokens:
        if token.type == "fence" and token.info == "bash":
            yield from token.content.replace("\\\n", " ").splitlines()
        for child in token.children or ():
            if child.type == "code_inline":
                yield child.content


@pytest.fixture(scope="module")
def mentioned() -> dict[str, list[tuple[str, list[str]]]]:
    """By program: the page of each command that is mentioned, and the words after the program."""
    found = {
        (page.name, span.partition("  #")[0])
        for page in PAGES
        for span in _spans(page)
        if span.split()[:1]
    }
    commands: dict[str, list[tuple[str, list[str]]]] = {}
    for page, span in sorted(found):
        program, *words = _words(span) or [""]
        commands.setdefault(program, []).append((page, words))
    return commands


def _words(span: str) -> list[str]:
    return re.sub(r"[\[\]…]", " ", span).split()


def test_ptnsbc(mentioned):
    known = {id(COMMANDS): _options(COMMANDS)}
    wrong = []
    for page, words in mentioned["ptnsbc"]:
        command, rest = COMMANDS, list(words)
        while rest and rest[0] in getattr(command, "commands", {}):
            command = command.commands[rest.pop(0)]
        if command is COMMANDS and rest and re.fullmatch(r"(?!help)[a-z]\w*", rest[0]):
            wrong.append((page, words, "no such command"))
        options = known.setdefault(id(command), _options(command))
        if command is COMMANDS.commands["reproduce"]:
            options = options | _options(typer.main.get_command(paper_app))
        if command is COMMANDS.commands["network"].commands["node"] and rest and rest[0] != "NAME":
            options = options | _options_of_a_process(rest[0])
        given = set(re.findall(r"(?:^|[\s|])(--[a-z][\w-]*)", " ".join(rest)))
        if not given <= options:
            wrong.append((page, words, given - options))
    assert wrong == []


def _options(command):
    named = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    return named | {"--help"}


@cache
def _options_of_a_process(name):
    pytest.importorskip("rclpy")
    modules = {executable: module for module, executable in EXECUTABLES.items()}
    with redirect_stdout(StringIO()) as out, pytest.raises(SystemExit):
        importlib.import_module(modules[name]).main(["--help"])
    return set(re.findall(r"--[a-z][\w-]*", out.getvalue()))


def test_make(mentioned):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    wanted = {
        (page, word)
        for page, words in mentioned["make"]
        for word in words
        if re.fullmatch(r"[a-z]+", word)
    }
    assert {(page, word) for page, word in wanted if word not in targets} == set()


def test_python(mentioned):
    for page, words in mentioned["python"]:
        if words[0] == "-m":
            assert importlib.util.find_spec(words[1]), (page, words)
        else:
            assert (ROOT / words[0]).is_file(), (page, words)


def test_the_links_between_pages_lead_somewhere():
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    for name in listed:
        page = ROOT / name
        for token in MarkdownIt("commonmark").enable("table").parse(page.read_text("utf-8")):
            for child in token.children or ():
                target = child.attrGet("href") or child.attrGet("src") or ""
                path, _, anchor = target.partition("#")
                if "://" in target or not target:
                    continue
                found = (page.parent / path).resolve() if path else page
                assert found.exists(), f"{name}: {target}"
                if anchor and found.suffix == ".md":
                    assert anchor in _anchors(found), f"{name}: {target}"


def _anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a page."""
    titles = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", title.lower()) for title in titles)
    return {title.replace(" ", "-") for title in plain}
