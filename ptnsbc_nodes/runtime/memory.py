"""The memory of a process: what it needed to start and does not need to work is given back, and the rest is kept.

Loading the laws reads most of LLVM's code and tables, and a process that has loaded them calls no LLVM again. These
pages are the same in all processes, but each process counts them as resident.
"""

from __future__ import annotations

import ctypes
import gc
import mmap
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_MAPPINGS = Path("/proc/self/smaps")
_HEAD = re.compile(r"([0-9a-f]+)-([0-9a-f]+) (\S+) \S+ \S+ \S+\s*(.*)")
# Options of mallopt in the C library of GNU.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_KEPT = {
    _M_ARENA_MAX: 1,
    _M_TRIM_THRESHOLD: -1,  # never
    _M_MMAP_THRESHOLD: 32 * 2**20,  # the most that it takes: larger blocks have pages of their own
}
# The wheels of llvmlite contain LLVM; a Linux distribution has a library of its own for it.
_COMPILER = re.compile(r"libllvmlite|libLLVM")


class Mapping(NamedTuple):
    """Part of a file in the memory of this process."""

    start: int  # address
    end: int
    permissions: str  # as in `r-xp`
    file: str
    written_kb: int  # pages that differ from the file

    @property
    def is_clean(self) -> bool:
        """True if the kernel can read every page again from the file."""
        return self.permissions[:2] == "r-" and self.permissions[3] == "p" and not self.written_kb


def settle() -> None:
    """Call this once everything is loaded: no collection looks at it again, and free memory goes back."""
    gc.collect()
    gc.freeze()
    _call("malloc_trim", ctypes.c_size_t(0))
    release(_COMPILER)


def keep_heap() -> None:
    """Call this before the first thread starts: all threads share one heap, of which nothing goes back in flight.

    Otherwise the C library gives each thread a heap of its own. What the threads of the middleware took for one
    backlog of messages is then of no use to the others for the next one: beside twenty UAVs in real time a recorder
    grew by 2 % in ten minutes, and with one heap by 0.3 %; a sim in lock-step by 1.6 and 0.3 % (`bench.soak`).

    Now and then the C library gives the free end of a heap back. Its pages come again one by one, each with a fault,
    and such a recorder had sometimes 2 MB less than before and after. `settle` gives back what is free before a flight.
    """
    for option, value in _KEPT.items():
        _call("mallopt", ctypes.c_int(option), ctypes.c_int(value))


def release(files: re.Pattern[str]) -> None:
    """Let go of the unchanged pages of mapped files; whoever touches one again reads it from the file.

    Pages that were written, as the relocated tables of a library are, stay. Where the kernel offers none of this,
    nothing happens.
    """
    advice: int | None = getattr(mmap, "MADV_DONTNEED", None)
    if advice is None:
        return
    for one in tuple(mappings()):
        if one.is_clean and files.match(Path(one.file).name):
            size = ctypes.c_size_t(one.end - one.start)
            _call("madvise", ctypes.c_void_p(one.start), size, ctypes.c_int(advice))


def mappings() -> Iterator[Mapping]:
    """The mapped files of this process; none where the kernel does not tell."""
    with suppress(OSError), _MAPPINGS.open(encoding="utf-8", errors="replace") as lines:
        yield from _read(lines)


def _read(lines: Iterable[str]) -> Iterator[Mapping]:
    head, written_kb = None, 0
    for line in lines:
        if found := _HEAD.match(line):
            head, written_kb = found, 0
        elif line.startswith(("Anonymous:", "Swap:")):  # in memory, and moved out of it
            written_kb += int(line.split()[1])
        elif line.startswith("VmFlags:") and head is not None:  # the last line of a mapping
            yield Mapping(int(head[1], 16), int(head[2], 16), head[3], head[4], written_kb)


def _call(name: str, *arguments: object) -> None:
    """Call a function of the C library, if it has that one."""
    function = getattr(ctypes.CDLL(None), name, None)
    if function is not None:
        function(*arguments)
