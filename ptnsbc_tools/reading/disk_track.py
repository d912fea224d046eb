"""Tracks on the disk: a flight may need more memory than the machine has.

The samples of all tracks go into one temporary file, row by row, and are read back a few thousand rows at a time.
Stamps are almost always in order. A track whose stamps are not is sorted once, by its stamps alone (16 bytes of
memory per row).
"""

from __future__ import annotations

import os
import struct
import tempfile
import weakref
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Hashable
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.verdict.track import Series, Track

_ROWS = 1024  # of one piece of a track
_NEVER = -(2**63)
_HEAD = struct.Struct("<qq")  # stamp and log time; the values follow


class SampleFileError(PtnsbcError):
    """The temporary file cannot be written."""


class SampleFile:
    """A temporary file, which is closed with the last track that uses it."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="ptnsbc-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._end = 0

    def append(self, data: bytes | bytearray) -> int:
        """Append `data` and return its offset."""
        at = self._end
        try:
            self._end += os.pwrite(self._file.fileno(), data, at)
        except OSError as error:
            raise SampleFileError(
                f"{tempfile.gettempdir()}: {error.strerror}: samples are kept there while a bag is read: "
                "name another folder with TMPDIR"
            ) from error
        return at

    def read(self, at: int, size: int) -> bytes:
        """The `size` bytes at an offset."""
        return os.pread(self._file.fileno(), size, at)


class _Piece(NamedTuple):
    """Consecutive rows of a track in the file."""

    offset: int
    first_ns: int


class DiskTrack(Track):
    """A track whose samples are in a file."""

    def __init__(self, file: SampleFile, pieces: list[_Piece], size: int, width: int) -> None:
        self._file = file
        self._pieces = pieces
        self._dtype = np.dtype(
            [("stamp_ns", "<i8"), ("log_ns", "<i8"), ("values", "<f8", (width,))]
        )
        self._firsts = [piece.first_ns for piece in pieces]
        self.size = size
        self.first_ns = self._firsts[0]
        self.last_ns = int(self.read(size - 1, size)["stamp_ns"][0])

    def index(self, t_ns: int, side: Literal["left", "right"]) -> int:
        """Number of samples before `t_ns`; with `right` those at `t_ns` too."""
        find = bisect_left if side == "left" else bisect_right
        piece = find(self._firsts, t_ns) - 1
        if piece < 0:
            return 0
        first = piece * _ROWS
        stamps = self.read(first, min(first + _ROWS, self.size))["stamp_ns"]
        return first + int(np.searchsorted(stamps, t_ns, side=side))

    def rows(self, first: int, end: int) -> Series:
        """Samples number `first` to `end - 1`."""
        found = self.read(first, end)
        return Series(found["stamp_ns"].copy(), found["values"].copy())

    def column(self, name: str) -> NDArray[np.int64]:
        """`stamp_ns` or `log_ns` (T,) of all samples, in the order of the file."""
        firsts = range(0, self.size, _ROWS)
        parts = [self.read(k, min(k + _ROWS, self.size))[name].copy() for k in firsts]
        return np.concatenate(parts)

    def read(self, first: int, end: int) -> NDArray[np.void]:
        """Rows number `first` to `end - 1` as they are in the file."""
        size, parts = self._dtype.itemsize, []
        while first < end:
            last = min(end, (first // _ROWS + 1) * _ROWS)
            at = self._pieces[first // _ROWS].offset + first % _ROWS * size
            parts.append(self._file.read(at, (last - first) * size))
            first = last
        return np.frombuffer(b"".join(parts), self._dtype)


class TrackWriter:
    """Writes a track to the disk, message by message."""

    def __init__(self, file: SampleFile) -> None:
        self._file = file
        self._pieces: list[_Piece] = []
        self._buffer = bytearray()
        self._row_size = 0
        self._size = 0
        self._last_ns = _NEVER
        self._in_order = True

    def add(self, stamp_ns: int, log_ns: int, values: Array) -> None:
        """Take a sample; of two with the same stamp, as from a link that repeats messages, the last counts."""
        if stamp_ns == self._last_ns and stamp_ns:
            del self._buffer[-self._row_size :]
            self._size -= 1
        elif stamp_ns <= self._last_ns:
            self._in_order = False
        self._last_ns = stamp_ns
        self._append(_HEAD.pack(stamp_ns, log_ns) + values.astype("<f8", copy=False).tobytes())

    def track(self) -> Track:
        """The samples taken, at least one; no more may follow."""
        found = self._written()
        if self._in_order:
            return found
        stamps = found.column("stamp_ns")
        # When all stamps are zero the sender left the header empty; log times take their place.
        key = stamps if stamps.any() else found.column("log_ns")
        _, last = np.unique(key[::-1], return_index=True)
        order = key.size - 1 - last
        ordered = TrackWriter(self._file)
        for number in order.tolist():
            row = found.read(number, number + 1).tobytes()
            ordered._append(_HEAD.pack(int(key[number]), 0) + row[_HEAD.size :])
        return ordered._written()

    def _append(self, row: bytes) -> None:
        self._row_size = len(row)
        # The last row stays in the buffer: the next one may replace it.
        if len(self._buffer) == _ROWS * self._row_size:
            self._flush()
        self._buffer += row
        self._size += 1

    def _flush(self) -> None:
        first_ns, _ = _HEAD.unpack_from(self._buffer)
        self._pieces.append(_Piece(self._file.append(self._buffer), first_ns))
        self._buffer.clear()

    def _written(self) -> DiskTrack:
        if self._buffer:
            self._flush()
        return DiskTrack(self._file, self._pieces, self._size, (self._row_size - _HEAD.size) // 8)


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
