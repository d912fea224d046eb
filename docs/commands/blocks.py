"""The ```bash blocks of a page, and the comment before each that says how it is run.

    <!-- run: no, REASON -->              not at all
    <!-- run: by .ci/run -->              there: every line must be a command of that script
    <!-- run: for 3 s -->                 then Ctrl-C, which it must answer with 0 or 130
    <!-- run: each for 3 s -->            every line by itself, likewise
    <!-- run: beside, until "TEXT" -->    goes on in the background; the next block starts when it has
                                          said TEXT; Ctrl-C when the page is over, unless it has ended;
                                          `, exits 1` after that: with this code where it ends by itself;
                                          `, with WORDS` at the end, as below
    <!-- run: with --duration 3 -->       these words added to its one line, to make it short or light
    <!-- run: exits 1 -->                 with this code and no other
    <!-- run: where ros2 -->              only where there is such a program; one of the others may
                                          follow, as in `where ros2: for 3 s`

Without a comment a block is run as it stands and must exit with 0.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

LANGUAGES = ("bash", "sh", "shell", "console")


class PageError(Exception):
    """A page that cannot be run: a comment that means nothing, or a block that does not fit it."""


class How(Enum):
    """The treatment of a block."""

    RUN = "run"
    SKIP = "skip"
    ELSEWHERE = "by .ci/run"
    FOR = "for"
    EACH = "each for"
    BESIDE = "beside"


NOT_RUN = (How.SKIP, How.ELSEWHERE)


@dataclass(frozen=True)
class Marker:
    """The way in which a block is run."""

    how: How = How.RUN
    text: str = ""  # reason of a skip, or what a background block says when the next may start
    seconds: float = 0.0  # until Ctrl-C
    words: str = ""  # added to the line
    code: int = 0


@dataclass(frozen=True)
class Block:
    """One block of commands."""

    page: str
    line: int  # of the opening fence, from 1
    script: str
    marker: Marker = field(default_factory=Marker)

    @property
    def place(self) -> str:
        """Page and line, as editors open them."""
        return f"{self.page}:{self.line}"

    @property
    def lines(self) -> list[str]:
        """The commands, one by one; continued lines joined, remarks left out."""
        joined = self.script.replace("\\\n", " ")
        bare = (re.sub(r"(^|\s)#.*", "", line).strip() for line in joined.splitlines())
        return [line for line in bare if line]


_FORMS = (
    (r"no, (?P<text>\S.+)", How.SKIP),
    (r"by \.ci/run", How.ELSEWHERE),
    (r"for (?P<seconds>\d+) s", How.FOR),
    (r"each for (?P<seconds>\d+) s", How.EACH),
    (
        r'beside, until "(?P<text>[^"]+)"(, exits (?P<code>\d+))?(, with (?P<words>\S.*))?',
        How.BESIDE,
    ),
    (r"with (?P<words>\S.*)", How.RUN),
    (r"exits (?P<code>\d+)", How.RUN),
)
_WHERE = re.compile(r"where (?P<program>[\w.-]+)(: (?P<rest>\S.*))?")
_INSTALL = re.compile(r"(^|[;&|(]\s*|sudo )((python[\d.]*|uv) -m )?(pip[\d.]*|uv pip) install\b")
_COMMENT = re.compile(r"<!--\s*run:\s*(.*?)\s*-->", re.DOTALL)


def marker_of(text: str, place: str) -> Marker:
    """The marker that a comment holds."""
    said = " ".join(text.split())
    needed = _WHERE.fullmatch(said)
    if needed:
        if shutil.which(needed["program"]) is None:
            return Marker(How.SKIP, f"{needed['program']} is not installed")
        if needed["rest"] is None:
            return Marker()
        said = needed["rest"]
    for form, how in _FORMS:
        found = re.fullmatch(form, said)
        if found:
            given = found.groupdict()
            return Marker(
                how,
                given.get("text") or "",
                float(given.get("seconds") or 0),
                given.get("words") or "",
                int(given.get("code") or 0),
            )
    forms = (
        'no, REASON | by .ci/run | [each] for N s | beside, until "TEXT"[, exits N][, with WORDS] | '
        "with WORDS | exits N | where PROGRAM[: ...]"
    )
    raise PageError(f"{place}: run: {said}: expected {forms}")


def blocks_of(page: Path, name: str) -> list[Block]:
    """Every block of a page, in its order."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))
    return list(_blocks(tokens, name))


def _blocks(tokens: Sequence[Token], name: str) -> Iterator[Block]:
    pending: tuple[str, str] | None = None
    for token in tokens:
        place = f"{name}:{token.map[0] + 1}" if token.map else name
        said = _COMMENT.search(token.content) if token.type == "html_block" else None
        if said:
            pending = said[1], place
            continue
        if token.type == "fence" and token.info.split()[:1] and token.info.split()[0] in LANGUAGES:
            marker = marker_of(*pending) if pending else Marker()
            yield _fitting(Block(name, int(place.rpartition(":")[2]), token.content, marker))
        elif pending:
            raise PageError(
                f"{pending[1]}: run: {pending[0]}: expected a block of commands after it"
            )
        pending = None
    if pending:
        raise PageError(f"{pending[1]}: run: {pending[0]}: expected a block of commands after it")


def _fitting(block: Block) -> Block:
    run = block.marker.how not in NOT_RUN
    if run and any(_INSTALL.search(line) for line in block.lines):
        raise PageError(
            f"{block.place}: would install into the environment that runs it: expected the pip of an "
            "environment of its own, as in .try/bin/pip"
        )
    alone = block.marker.how in (How.FOR, How.BESIDE) or block.marker.words
    if alone and len(block.lines) != 1:
        raise PageError(f"{block.place}: {len(block.lines)} commands: expected one, as it is run")
    return block
