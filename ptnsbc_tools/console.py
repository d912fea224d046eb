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
    from rich.table import Table

_PATIENCE_S = 2.0
_COMPILING_SAY_S = 15.0  # between two lines
_COMPILING_LOOK_S = 0.25
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


def narrowed(table: Table, console: Console) -> list[Table]:
    """A table as several that keep their numbers at the width of a console: each has the first column and some more."""
    from rich.measure import Measurement
    from rich.table import Table

    def fits(one: Table) -> bool:
        return Measurement.get(console, console.options.update(width=1000), one).minimum <= limit

    limit, columns = console.width, table.columns
    found: list[Table] = []
    if fits(table) or len(columns) < 3:
        return [table]
    rows = [row.style for row in table.rows]

    def part(chosen: list[int]) -> Table:
        title = None if found else table.title
        made = Table(title=title, title_justify="left", title_style=table.title_style)
        for number in chosen:
            own = columns[number]
            made.add_column(own.header, justify=own.justify, overflow="fold")
        cells = [list(columns[number].cells) for number in chosen]
        for style, row in zip(rows, zip(*cells, strict=True), strict=True):
            made.add_row(*row, style=style)
        return made

    chosen = [0]
    for number in range(1, len(columns)):
        if len(chosen) > 1 and not fits(part([*chosen, number])):
            found.append(part(chosen))
            chosen = [0]
        chosen.append(number)
    return [*found, part(chosen)]


def say(line: str) -> None:
    """One line on stderr, at once."""
    print(plain(line), file=sys.stderr, flush=True)


def counted(number: int, what: str) -> str:
    """A number of things in words: 1 message, 2 messages."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def show(line: str) -> None:
    """One line on stdout."""
    print(plain(line))


def print_json(data: Mapping[str, Any]) -> None:
    """One object on stdout, in one line."""
    print(json.dumps(data, allow_nan=False), flush=True)


def compiling() -> _Compilation:
    """Around the first use of the laws: says on stderr what is compiled when it takes longer than a moment."""
    return _Compilation()


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


class _Compilation:
    """Names the function that is compiled, how many have been, and the time since the begin."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)
        self._began = time.monotonic()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _show(self) -> None:
        if self._ended.wait(_PATIENCE_S):
            return
        with _counted_compilations() as compiled:
            while not compiled:  # laws from the cache, or interpreted ones, are not compiled
                if self._ended.wait(_COMPILING_LOOK_S):
                    return
            say_once(COMPILING)
            if not sys.stderr.isatty():
                told = 0
                while not self._ended.wait(_COMPILING_SAY_S):
                    # The work after the compilation has words of its own.
                    if len(compiled) > told:
                        told = len(compiled)
                        say(self._words(compiled))
                return
            with err().status(self._words(compiled)) as status:
                while not self._ended.wait(_COMPILING_LOOK_S):
                    status.update(self._words(compiled))

    def _words(self, compiled: list[str]) -> str:
        elapsed_s = time.monotonic() - self._began
        return f"compiling: {elapsed_s:.0f} s, {len(compiled)} functions, now {compiled[-1]}"


@contextmanager
def _counted_compilations() -> Iterator[list[str]]:
    """The names of the functions that numba begins to compile inside the `with`."""
    from ptnsbc_core.kernel import COMPILED

    names: list[str] = []
    if not COMPILED:
        yield names
        return
    from numba.core import event

    class Named(event.Listener):
        def on_start(self, one: Any) -> None:
            names.append(one.data["dispatcher"].py_func.__name__)

        def on_end(self, one: Any) -> None:
            pass

    listener = Named()
    event.register("numba:compile", listener)
    try:
        yield names
    finally:
        event.unregister("numba:compile", listener)


@cache
def say_once(line: str) -> None:
    """A line on stderr, and not again: the check and the flight may both have to compile."""
    say(line)


def watched() -> bool:
    """True if somebody looks: in a terminal, and in a notebook."""
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
