"""Commands that the text of a page mentions, between backticks: each exists, and takes the options it is given."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer.main
from markdown_it import MarkdownIt

from paper.command import app as paper_app
from ptnsbc_nodes.fleet.child_process import EXECUTABLES
from ptnsbc_tools.cli import every_command

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


def _mentioned(first: str) -> list[tuple[str, str]]:
    found = {
        (page.name, " ".join(span.partition("  #")[0].split()))
        for page in PAGES
        for span in _spans(page)
        if span.split()[:1] == [first]
    }
    return sorted(found)


def _words(span: str) -> list[str]:
    return re.sub(r"[\[\]…]", " ", span).split()


@pytest.mark.parametrize(("page", "span"), _mentioned("ptnsbc"))
def test_ptnsbc(page, span, capsys):
    command, words = COMMANDS, _words(span)[1:]
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    at_the_root = command is COMMANDS and words and re.fullmatch(r"[a-z]\w*", words[0])
    assert not at_the_root, f"{page}: `{span}`: no command {words[0]}"
    known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    if command is COMMANDS.commands["reproduce"]:
        known |= {option for one in typer.main.get_command(paper_app).params for option in one.opts}
    if command is COMMANDS.commands["node"] and words and words[0] != "NAME":
        known |= _options_of_a_process(words[0], capsys)
    given = {word for word in re.findall(r"(?:^|[\s|])(--[a-z][\w-]*)", " ".join(words))}
    assert given <= known | {"--help"}, f"{page}: `{span}`"


def _options_of_a_process(name, capsys):
    pytest.importorskip("rclpy")
    modules = {executable: module for module, executable in EXECUTABLES.items()}
    with pytest.raises(SystemExit):
        importlib.import_module(modules[name]).main(["--help"])
    return set(re.findall(r"--[a-z][\w-]*", capsys.readouterr().out))


@pytest.mark.parametrize(("page", "span"), _mentioned("make"))
def test_make(page, span):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    wanted = {word for word in _words(span)[1:] if re.fullmatch(r"[a-z]+", word)}
    assert wanted <= targets, f"{page}: `{span}`"


@pytest.mark.parametrize(("page", "span"), _mentioned("python"))
def test_python(page, span):
    words = _words(span)[1:]
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1]), f"{page}: `{span}`"
    else:
        assert (ROOT / words[0]).is_file(), f"{page}: `{span}`"


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
