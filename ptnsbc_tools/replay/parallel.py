"""Work shared out among processes that are copies of this one: what is loaded need not be loaded again."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from ptnsbc_core.errors import PtnsbcError

T = TypeVar("T")


class PartError(PtnsbcError):
    """A part of the work that came to nothing."""


def side_by_side(work: Sequence[Callable[[], T]]) -> list[T]:
    """Results of all of `work`: the first in this process, each other in one of its own.

    Raises:
        PtnsbcError: what the work raised, or a process that was killed.
    """
    forked = multiprocessing.get_context("fork")
    others = []
    for part in work[1:]:
        ours, theirs = forked.Pipe(duplex=False)
        process = forked.Process(target=_send, args=(part, theirs), daemon=True)
        process.start()
        theirs.close()
        others.append((process, ours))
    try:
        found = [work[0]()]
        for process, ours in others:
            found.append(_received(ours))
            process.join()
        return found
    finally:
        for process, ours in others:
            process.kill()
            process.join()
            ours.close()


def _send(part: Callable[[], T], to: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the first, which ends the others
    result: T | PtnsbcError
    try:
        result = part()
    except PtnsbcError as error:
        result = error
    to.send(result)


def _received(ours: Connection) -> Any:
    try:
        result = ours.recv()
    except EOFError:
        raise PartError("a process of the re-run has ended: was it killed?") from None
    if isinstance(result, PtnsbcError):
        raise result
    return result
