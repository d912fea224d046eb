"""Signals to end: an exit at once while a process starts, a question to ask once it has work to put in order.

They are SIGINT, SIGTERM, and SIGHUP of a terminal that is closed; who ignores that one, as nohup has it, goes on.

This module imports little, and only of the standard library, so that a process has its handlers before all else.
"""

from __future__ import annotations

import atexit
import os
import select
import signal
import stat
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_Handler = Callable[[int, FrameType | None], object]
_Setting = _Handler | int | signal.Handlers | None
_replaced: dict[signal.Signals, _Setting] = {}  # handlers from before `exit_on_signal`


def exit_on_signal(exit_code: int = 0, message: str = "") -> None:
    """From now on these signals end this process at once: the first statement of every `main`.

    A process that starts has nothing to put in order yet, and an exception in the middle of an import
    may be lost. A `StopRequest` takes over when there is something to put in order.
    """

    def leave(_number: int, _frame: FrameType | None) -> None:
        if message:
            os.write(2, f"{message}\n".encode())
        os._exit(exit_code)

    before = install_handler(leave)
    if not _replaced:
        _replaced.update(before)


def keep_exit_code(exit_code: int) -> None:
    """The work of this process is done: from now on no signal changes its exit code.

    While the interpreter ends, Python gives the signals back to the system, and one that comes then would
    kill the process. So they are ignored from the last exit function on.
    """
    exit_on_signal(exit_code)
    atexit.unregister(_ignore_signals)
    atexit.register(_ignore_signals)


def _ignore_signals() -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def restore_handlers() -> None:
    """Give back the handlers from before `exit_on_signal`."""
    for number, handler in _replaced.items():
        signal.signal(number, handler)
    _replaced.clear()
    atexit.unregister(_ignore_signals)


@contextmanager
def signals_blocked() -> Iterator[None]:
    """A process that is started inside the `with` receives its signals when it installs its handlers."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class StopRequest:
    """A request to stop: true when one of the signals has come inside the `with`; their old handlers return after it.

    Outside the main thread Python allows no handlers, and no signal is noticed.
    """

    def __init__(self) -> None:
        self.count = 0
        # A signal interrupts a waiting `select` only if there is something to read.
        self._reader, self._writer = os.pipe()
        weakref.finalize(self, os.close, self._reader)
        weakref.finalize(self, os.close, self._writer)
        self._before: dict[signal.Signals, _Setting] = {}

    @property
    def came(self) -> bool:
        """True if any has come."""
        return self.count > 0

    def __enter__(self) -> StopRequest:
        self._before = install_handler(self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def wait(self, seconds: float) -> bool:
        """Sleep until one comes, at most so long; whether one has come."""
        if not self.came and seconds > 0:
            select.select([self._reader], [], [], seconds)
        return self.came

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self.count == 1:
            os.write(self._writer, b"!")


def _without_terminal(handler: _Handler) -> _Handler:
    """The handler of SIGHUP: once, because the kernel and a shell may both send it, and that is no second request.

    Writing to the terminal that is gone would be an error: what is still to be said goes nowhere.
    """

    def hang_up(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        for stream in (1, 2):
            if stat.S_ISCHR(os.fstat(stream).st_mode) and not os.isatty(stream):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream)
                os.close(nowhere)
        handler(number, frame)

    return hang_up


def install_handler(handler: _Handler) -> dict[signal.Signals, _Setting]:
    """Set the handler and unblock the signals, which the launcher blocks at the start; returns the old handlers."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    before = {number: signal.signal(number, handler) for number in _SIGNALS[:2]}
    if (hung_up := signal.getsignal(signal.SIGHUP)) is not signal.SIG_IGN:
        before[signal.SIGHUP] = hung_up
        signal.signal(signal.SIGHUP, _without_terminal(handler))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    return before
