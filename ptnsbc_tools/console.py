"""Output of the command line: results on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_PATIENCE_S = 2.0
COMPILING = "compiling laws (at their first use)"
_FIXED_WIDTH = 120  # a pipe has no width, and grep cannot read a table that is cut at 80 columns


Advance = Callable[[int, int], None]
"""The function that long work calls now and then: so many steps are done, of all."""


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

    wide, columns = console.options.update(width=1000), table.columns

    def fits(part: Table) -> bool:
        return Measurement.get(console, wide, part).minimum <= console.width

    def part(chosen: list[int], title: Any) -> Table:
        narrow = Table(title=title, title_justify="left", title_style=table.title_style)
        for column in (columns[number] for number in chosen):
            narrow.add_column(column.header, justify=column.justify, overflow="fold")
        cells = zip(*(columns[number].cells for number in chosen), strict=True)
        for row, of_row in zip(table.rows, cells, strict=True):
            narrow.add_row(*of_row, style=row.style)
        return narrow

    if fits(table) or len(columns) < 3:
        return [table]
    chosen = [[0]]  # the columns of each part
    for number in range(1, len(columns)):
        title = None if chosen[1:] else table.title
        if len(chosen[-1]) > 1 and not fits(part([*chosen[-1], number], title)):
            chosen.append([0])
        chosen[-1].append(number)
    return [part(numbers, None if k else table.title) for k, numbers in enumerate(chosen)]


def say(line: str) -> None:
    """One line on stderr, at once."""
    print(plain(line), file=sys.stderr, flush=True)


def program() -> str:
    """The word that starts ptnsbc in this shell: its path, where PATH does not lead to it."""
    script = Path(sys.argv[0])
    return "ptnsbc" if script.name != "ptnsbc" or which("ptnsbc") else os.path.relpath(script)


def counted(number: int, what: str) -> str:
    """A number of things in words: 1 message, 2 messages."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def show(line: str) -> None:
    """One line on stdout."""
    print(plain(line))


def print_json(data: Mapping[str, Any]) -> None:
    """One object on stdout, in one line."""
    print(json.dumps(data, allow_nan=False), flush=True)


@contextmanager
def compiling() -> Iterator[None]:
    """Around the first use of the laws: progress and time on stderr when they are compiled for longer than a moment.

    A function takes three quarters of its time when it is translated, and the last one when its kernel is optimised.
    """
    from ptnsbc_core.kernel import COMPILED, LAWS

    if not COMPILED:  # interpreted
        yield
        return
    from numba.core import event

    begin_s, begun, depth, optimised = time.monotonic(), 0, 0, 0
    advance: Advance | None = None

    class Watch(event.Listener):
        def on_start(self, event: Any) -> None:
            nonlocal begun, depth
            begun, depth = begun + 1, depth + 1
            self.show()

        def on_end(self, event: Any) -> None:
            nonlocal depth, optimised
            depth -= 1
            optimised = optimised if depth else begun
            self.show()

        def show(self) -> None:
            nonlocal advance
            if advance is None and time.monotonic() - begin_s > _PATIENCE_S:
                advance = shown.enter_context(progress(COMPILING))
            if advance is not None:
                advance(3 * begun + optimised, 4 * max(len(LAWS), begun))

    with ExitStack() as shown, event.install_listener("numba:compile", Watch()):
        yield
    if advance is not None:
        say(f"{COMPILING}: done in {time.monotonic() - begin_s:.0f} s")


@contextmanager
def patience(line: str) -> Iterator[None]:
    """Around work without progress: prints `line` on stderr when it takes longer than a moment."""
    timer = threading.Timer(_PATIENCE_S, say, (line,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def progress(label: str, wanted: bool | None = True) -> Iterator[Advance]:
    """Progress on stderr: a bar on a terminal, else a line every few seconds; None: only where somebody looks."""
    if wanted is None:
        wanted = sys.stderr.isatty() or "ipykernel" in sys.modules
    if not wanted:
        yield lambda done, total: None
        return
    if not sys.stderr.isatty():
        begin_s = shown_s = time.monotonic()
        at_first: int | None = None

        def advance(done: int, total: int, /) -> None:  # a line every few seconds
            nonlocal shown_s, at_first
            at_first, now_s = done if at_first is None else at_first, time.monotonic()
            if now_s - shown_s > _PATIENCE_S:
                shown_s, steps = now_s, done - at_first
                left = f", {(now_s - begin_s) * (total - done) / steps:.0f} s left" if steps else ""
                say(f"{label}: {100 * done // max(total, 1)} %{left}")

        yield advance
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err(), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
