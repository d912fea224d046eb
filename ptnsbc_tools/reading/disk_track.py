"""Tracks on the disk: a flight may need more memory than the machine has.

The samples of all tracks go into one temporary file, row by row; at the end each track is copied to one place in it,
which is mapped into memory. Stamps are almost always in order. A track whose stamps are not is sorted once.
"""

from __future__ import annotations

import os
import struct
import tempfile
import weakref
from collections import defaultdict
from collections.abc import Hashable, Iterable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.verdict.track import Track

_ROWS = 1024  # of one piece of a track
_NEVER = -(2**63)
_HEAD = struct.Struct("<qq")  # stamp and log time; the values follow


class SampleFile:
    """A temporary file, which is gone with the last track in it."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="ptnsbc-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)  # what is mapped stays
        self._end = 0

    def append(self, data: bytes | bytearray) -> int:
        """Append `data` and return its offset."""
        at = self._end
        try:
            self._end += os.pwrite(self._file.fileno(), data, at)
        except OSError as error:
            raise PtnsbcError(
                f"{tempfile.gettempdir()}: {error.strerror}: samples are kept there while a bag is read: "
                "name another folder with TMPDIR"
            ) from error
        return at

    def read(self, at: int, size: int) -> bytes:
        """The `size` bytes at an offset."""
        return os.pread(self._file.fileno(), size, at)

    def joined(self, parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """Arrays, at least one, one after another as one array on the disk."""
        at, rows = self._end, 0
        for part in parts:
            self.append(part.tobytes())
            rows += len(part)
        return np.asarray(np.memmap(self._file, part.dtype, "r", at, (rows, *part.shape[1:])))


class TrackWriter:
    """Writes a track to the disk, message by message."""

    def __init__(self, file: SampleFile) -> None:
        self._file = file
        self._pieces: list[tuple[int, int]] = []  # offset and size of consecutive rows
        self._buffer = bytearray()
        self._row_size = 0
        self._last_ns = _NEVER
        self._in_order = True

    def add(self, stamp_ns: int, log_ns: int, values: Array) -> None:
        """Take a sample; of two with the same stamp, as from a link that repeats messages, the last counts."""
        if stamp_ns == self._last_ns and stamp_ns:
            del self._buffer[-self._row_size :]
        elif stamp_ns <= self._last_ns:
            self._in_order = False
        self._last_ns = stamp_ns
        # The last row stays in the buffer: the next one may replace it.
        if self._buffer and len(self._buffer) == _ROWS * self._row_size:
            self._flush()
        row = _HEAD.pack(stamp_ns, log_ns) + values.astype("<f8", copy=False).tobytes()
        self._row_size = len(row)
        self._buffer += row

    def track(self) -> Track:
        """The samples taken, at least one; no more may follow."""
        self._flush()
        stamps, values = self._column("stamp_ns"), self._column("values")
        if self._in_order:
            return Track(stamps, values)
        # When all stamps are zero the sender left the header empty; log times take their place.
        key = stamps if stamps.any() else self._column("log_ns")
        _, last = np.unique(key[::-1], return_index=True)
        order = key.size - 1 - last
        parts = [order[first : first + _ROWS] for first in range(0, order.size, _ROWS)]
        return Track(*(self._file.joined(of[part] for part in parts) for of in (key, values)))

    def _flush(self) -> None:
        self._pieces.append((self._file.append(self._buffer), len(self._buffer)))
        self._buffer.clear()

    def _column(self, name: str) -> NDArray[Any]:
        width = (self._row_size - _HEAD.size) // 8
        row = np.dtype([("stamp_ns", "<i8"), ("log_ns", "<i8"), ("values", "<f8", (width,))])
        pieces = (np.frombuffer(self._file.read(*piece), row) for piece in self._pieces)
        return self._file.joined(piece[name] for piece in pieces)


Key = TypeVar("Key", bound=Hashable)


class TrackWriters(Generic[Key]):
    """Tracks by key, all in one file."""

    def __init__(self, file: SampleFile) -> None:
        self._writers: dict[Key, TrackWriter] = defaultdict(lambda: TrackWriter(file))

    def add(self, key: Key, stamp_ns: int, values: Array, log_ns: int | None = None) -> None:
        """Take a sample of one track; its log time is its stamp by default."""
        self._writers[key].add(stamp_ns, stamp_ns if log_ns is None else log_ns, values)

    def tracks(self) -> dict[Key, Track]:
        """All tracks, in the order of their first samples; no more samples may follow."""
        return {key: writer.track() for key, writer in self._writers.items()}
