"""The bond between a process and its launcher: the process ends with it, and reports to it through a pipe.

No vehicle is left alone: a process that a launcher has started ends with it, even when the launcher is killed. An
orphan would fly on unnoticed. Only the kernel can promise this, by `PR_SET_PDEATHSIG` of prctl(2), for which Python
has no function.

A report is a line with a word and its text: `running` once the process serves its node, `finished SUMMARY` once its
work is done, with the summary as JSON.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import weakref
from contextlib import suppress

PARENT = "PTNSBC_PARENT"
"""Process id of the launcher: a process that has it set ends with the launcher."""
REPORT = "PTNSBC_REPORT_FD"
"""File descriptor of the pipe to the launcher."""
_PR_SET_PDEATHSIG = 1
_RUNNING, _FINISHED = "running", "finished"


def stay_with_launcher() -> None:
    """End with the launcher; SystemExit when it has ended already."""
    parent = os.environ.get(PARENT)
    # The launcher itself may be called from another fleet.
    if parent in (None, str(os.getpid())) or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM))
    if launcher_ended():
        raise SystemExit("the launcher has ended")


def launcher_ended() -> bool:
    """True if a launcher has started this process, and has ended."""
    return os.environ.get(PARENT) not in (None, str(os.getpid()), str(os.getppid()))


def report_running() -> None:
    """Report that everything is loaded and the node is served."""
    _report(f"{_RUNNING}\n")


def report_finished(summary: str) -> None:
    """Report that the work of this process is done, and with what result; nothing is reported after it."""
    _report(f"{_FINISHED} {json.dumps(summary)}\n")
    descriptor = os.environ.pop(REPORT, None)
    if descriptor is not None:
        with suppress(OSError):
            os.close(int(descriptor))


def _report(line: str) -> None:
    descriptor = os.environ.get(REPORT)
    if descriptor is not None:
        with suppress(OSError):  # the launcher may be gone
            os.write(int(descriptor), line.encode())


class Reports:
    """The launcher's end of the pipe to one process; the process inherits `writer`."""

    def __init__(self) -> None:
        self._reader, self.writer = os.pipe()
        weakref.finalize(self, os.close, self._reader)
        os.set_blocking(self._reader, False)
        self._received = b""

    @property
    def running(self) -> bool:
        """True once the process serves its node."""
        return any(line == _RUNNING for line in self.lines())

    @property
    def summary(self) -> str | None:
        """The result of its work; None before it has finished."""
        for line in self.lines():
            word, _, text = line.partition(" ")
            if word == _FINISHED:
                return str(json.loads(text))
        return None

    def lines(self) -> list[str]:
        """The whole lines so far; takes in what the process has reported."""
        with suppress(BlockingIOError):
            while part := os.read(self._reader, 1 << 16):
                self._received += part
        return self._received.decode().split("\n")[:-1]
