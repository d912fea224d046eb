"""Output of the command line: results on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol, TextIO

if TYPE_CHECKING:
    from rich.console import Console

_PATIENCE_S = 2.0
COMPILING = "compiling the laws (once; then read from the cache)"
_FIXED_WIDTH = 120  # a pipe has no width, and grep cannot read a table that is cut at 80 columns


class Advance(Protocol):
    """The function that long work calls now and then."""

    def __call__(self, done: int, total: int, /) -> None:
        """`done` of `total` steps are done."""


def out() -> Console:
    """A console on the current stdout, which tests and pipes replace."""
    return _console(sys.stdout)


def err() -> Console:
    """A console on the current stderr."""
    return _console(sys.stderr)


def _console(stream: TextIO) -> Console:
    width = None if stream.isatty() else _FIXED_WIDTH
    return _plain_console()(file=stream, width=width, markup=False, emoji=False)


def recording(stream: TextIO, width: int) -> Console:
    """A console of this width that can export what was printed."""
    return _plain_console()(file=stream, width=width, markup=False, emoji=False, record=True)


@cache
def _plain_console() -> type[Console]:
    from rich.console import Console

    class PlainConsole(Console):
        """Prints texts as they are: what a bag names `[/b]` is no markup, and what it holds is no command."""

        def render_str(self, text: str, **options: Any) -> Any:
            return super().render_str(plain(text), **options)

    return PlainConsole


def plain(text: str) -> str:
    """A text from outside for a terminal: characters that would act on it are written as escapes."""
    return "".join(
        char if char.isprintable() or char in "\n\t" else char.encode("unicode_escape").decode()
        for char in text
    )


def say(line: str) -> None:
    """One line on stderr, at once."""
    print(plain(line), file=sys.stderr, flush=True)


def show(line: str) -> None:
    """One line on stdout."""
    print(plain(line))


def print_json(data: Mapping[str, Any]) -> None:
    """One object on stdout, in one line."""
    print(json.dumps(data, allow_nan=False), flush=True)


def compiling() -> _LateCall:
    """Around the first use of the laws: prints a line on stderr when it takes longer than a moment."""
    return _LateCall(_say_compiling)


def patience(line: str) -> _LateCall:
    """Around work without progress: prints `line` on stderr when it takes longer than a moment."""
    return _LateCall(lambda: say(line))


class _LateCall:
    """Calls a function when its block takes longer than a moment."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._timer = threading.Timer(_PATIENCE_S, call)
        self._timer.daemon = True

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()


@cache
def _say_compiling() -> None:
    # Once: the check and the flight may both have to compile.
    say(COMPILING)


def watched() -> bool:
    """Whether somebody looks: in a terminal, and in a notebook."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def progress(label: str, wanted: bool | None = True) -> Iterator[Advance]:
    """Progress on stderr: a bar on a terminal, else a line every few seconds.

    Args:
        label: what is done.
        wanted: False: none; None: only where somebody looks.
    """
    if not (watched() if wanted is None else wanted):
        yield lambda done, total: None
        return
    if not sys.stderr.isatty():
        yield _ProgressLines(label)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err(), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


class _ProgressLines:
    """Progress as plain lines, at most one every few seconds."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._shown = time.monotonic()

    def __call__(self, done: int, total: int, /) -> None:
        now = time.monotonic()
        if now - self._shown > _PATIENCE_S:
            self._shown = now
            say(f"{self._label}: {100 * done // max(total, 1)} %")
