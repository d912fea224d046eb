"""Ctrl-C takes effect between two records of a bag, never inside one.

A KeyboardInterrupt inside the MCAP library leaves half a record in the chunk, and the bag is unreadable
from there on. Under full load that happened with a quarter of all Ctrl-C.
"""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType


class InterruptGuard:
    """Delays SIGINT while its `with` block runs and raises KeyboardInterrupt after the block.

    It acts only where Python's default handler would: in the main thread, when the program has no
    handler of its own, and without rclpy, whose handler in C must stay in place.
    """

    def __init__(self) -> None:
        self._installed = False
        self._busy = False
        self._pending = False

    def install(self) -> None:
        """Replace Python's default handler of SIGINT."""
        default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        main = threading.current_thread() is threading.main_thread()
        if default and main and "rclpy" not in sys.modules:
            signal.signal(signal.SIGINT, self._on_signal)
            self._installed = True

    def remove(self) -> None:
        """Restore Python's default handler."""
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
        if self._pending:
            self._pending = False
            raise KeyboardInterrupt

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._busy:
            self._pending = True
        else:
            signal.default_int_handler(number, frame)
