"""Ctrl-C between records, never inside one.

A KeyboardInterrupt inside the MCAP library leaves half a record in the chunk and the bag unreadable
from there on: under full load that was a quarter of all Ctrl-C.
"""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType


class InterruptGuard:
    """Holds SIGINT back while its `with` block runs and raises KeyboardInterrupt after it.

    It acts only where Python's own handler would: not in threads, not when the program has a
    handler of its own, and not beside rclpy, whose handler in C must stay in place.
    """

    def __init__(self) -> None:
        self._installed = False
        self._busy = False
        self._held = False

    def install(self) -> None:
        """Take SIGINT over from Python's default handler."""
        own = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        main = threading.current_thread() is threading.main_thread()
        if own and main and "rclpy" not in sys.modules:
            signal.signal(signal.SIGINT, self._on_signal)
            self._installed = True

    def remove(self) -> None:
        """Give SIGINT back."""
        if self._installed and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self._installed = False

    def __enter__(self) -> None:
        self._busy = True

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._busy = False
        if self._held:
            self._held = False
            raise KeyboardInterrupt

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._busy:
            self._held = True
        else:
            signal.default_int_handler(number, frame)
