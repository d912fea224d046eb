"""What is said where: results on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

_PATIENCE_S = 2.0
COMPILING = "compiling the laws (once; then read from the cache)"
_FIXED_WIDTH = 120  # a pipe has no width, and a table cut at 80 columns cannot be read by grep


class Advance(Protocol):
    """What long work calls now and then."""

    def __call__(self, done: int, total: int, /) -> None:
        """`done` out of `total` steps are done."""


def out() -> Console:
    """Stdout as it is now: tests and pipes exchange it."""
    return Console(file=sys.stdout, width=None if sys.stdout.isatty() else _FIXED_WIDTH)


def err() -> Console:
    """Stderr as it is now."""
    return Console(file=sys.stderr, width=None if sys.stderr.isatty() else _FIXED_WIDTH)


def print_json(data: Mapping[str, Any]) -> None:
    """One object on stdout, one line."""
    print(json.dumps(data, allow_nan=False), flush=True)


@contextmanager
def compiling() -> Iterator[None]:
    """Around the first use of the laws: a line on stderr when it is not over in a moment."""
    with _said_late(_say_compiling):
        yield


@contextmanager
def patience(line: str) -> Iterator[None]:
    """Around work that cannot tell how far it is: `line` on stderr when it takes its time."""
    with _said_late(lambda: print(line, file=sys.stderr, flush=True)):
        yield


@contextmanager
def _said_late(say: Callable[[], None]) -> Iterator[None]:
    timer = threading.Timer(_PATIENCE_S, say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@cache
def _say_compiling() -> None:
    # Once: the check and the flight may both have to compile.
    print(COMPILING, file=sys.stderr, flush=True)


@contextmanager
def progress(label: str) -> Iterator[Advance]:
    """A bar on stderr: on a terminal at once, elsewhere a line when work takes longer."""
    if sys.stderr.isatty():
        with _bar() as bar:
            task = bar.add_task(label, total=None)
            yield lambda done, total: bar.update(task, completed=done, total=total)
        return
    yield _ProgressLines(label)


def _bar() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    return Progress(*columns, console=err(), transient=True)


class _ProgressLines:
    """Progress as plain lines, no more than one every few seconds."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._shown = time.monotonic()

    def __call__(self, done: int, total: int, /) -> None:
        now = time.monotonic()
        if now - self._shown > _PATIENCE_S:
            self._shown = now
            print(f"{self._label}: {100 * done // max(total, 1)} %", file=sys.stderr, flush=True)
