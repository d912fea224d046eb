"""SIGINT and SIGTERM as a question to ask, for loops that must end in order."""

from __future__ import annotations

import os
import select
import signal
import threading
import weakref
from types import FrameType
from typing import Any

_NUMBERS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Whether one of the signals has come inside the `with`; their old handlers return after it.

    Outside the main thread Python allows no handlers, and nothing is noticed.
    """

    def __init__(self) -> None:
        self.count = 0
        # A signal wakes who waits: the call goes on after its handler, unless there is something to read.
        self._come, self._tell = os.pipe()
        weakref.finalize(self, os.close, self._come)
        weakref.finalize(self, os.close, self._tell)
        self._before: dict[signal.Signals, Any] = {}

    @property
    def came(self) -> bool:
        """Whether any has come."""
        return self.count > 0

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._on_signal) for number in _NUMBERS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def wait(self, seconds: float) -> bool:
        """Sleep until one comes, at most so long; whether one has come."""
        if not self.came and seconds > 0:
            select.select([self._come], [], [], seconds)
        return self.came

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.count += 1
        if self.count == 1:
            os.write(self._tell, b"!")
