"""Tracks on the disk: a flight may be longer than the memory is large.

What is decoded from a bag goes into one temporary file, row by row, and comes back a few thousand rows at a
time. Stamps are in order almost always; rows of a track whose stamps are not are sorted once, by their
stamps alone (16 bytes a row in memory).
"""

from __future__ import annotations

import os
import struct
import tempfile
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_tools.verdict.track import Series, Track

_ROWS = 1024  # of one piece of a track
_NEVER = -(2**63)
_HEAD = struct.Struct("<qq")  # stamp, time of logging; the values follow


class SpoolError(PtnsbcError):
    """No room for what is read."""


class DiskTrack:
    """A temporary file that goes with the last who uses it."""

    def __init__(self) -> None:
        # Open for as long as a track is: the last one to go closes it.
        self._file = tempfile.TemporaryFile(prefix="ptnsbc-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._end = 0

    def put(self, data: bytes | bytearray) -> int:
        """Append; returns where."""
        at = self._end
        try:
            self._end += os.pwrite(self._file.fileno(), data, at)
        except OSError as error:
            raise SpoolError(
                f"{tempfile.gettempdir()}: {error.strerror}: what is judged is kept there while a bag is "
                "read: name another folder with TMPDIR"
            ) from error
        return at

    def get(self, at: int, size: int) -> bytes:
        """What was put there."""
        return os.pread(self._file.fileno(), size, at)


class _Piece(NamedTuple):
    """Rows of a track that are together in the file."""

    offset: int
    first_ns: int


def _row(width: int) -> np.dtype[np.void]:
    """A row: its stamp, when it was logged, its values."""
    return np.dtype([("stamp_ns", "<i8"), ("log_ns", "<i8"), ("values", "<f8", (width,))])


class Spooled(Track):
    """A track whose samples are in a spool."""

    def __init__(self, spool: DiskTrack, pieces: list[_Piece], size: int, width: int) -> None:
        self._spool = spool
        self._pieces = pieces
        self._size = size
        self._dtype = _row(width)
        self._firsts = [piece.first_ns for piece in pieces]
        self._last_ns = int(self._read(size - 1, size)["stamp_ns"][0])

    @property
    def size(self) -> int:
        """How many there are."""
        return self._size

    @property
    def first_ns(self) -> int:
        """Time of the first."""
        return self._firsts[0]

    @property
    def last_ns(self) -> int:
        """Time of the last."""
        return self._last_ns

    def index(self, t_ns: int, side: Literal["left", "right"]) -> int:
        """How many samples are before `t_ns`; with `right` those at `t_ns` too."""
        find = bisect_left if side == "left" else bisect_right
        piece = find(self._firsts, t_ns) - 1
        if piece < 0:
            return 0
        first = piece * _ROWS
        stamps = self._read(first, min(first + _ROWS, self._size))["stamp_ns"]
        return first + int(np.searchsorted(stamps, t_ns, side=side))

    def rows(self, first: int, end: int) -> Series:
        """Samples number `first` to `end - 1`."""
        found = self._read(first, end)
        return Series(found["stamp_ns"].copy(), found["values"].copy())

    def logged(self) -> NDArray[np.int64]:
        """When each was logged (T,): all of them at once."""
        return self._column("log_ns")

    def stamped(self) -> NDArray[np.int64]:
        """The stamps (T,), all of them at once, whatever their order."""
        return self._column("stamp_ns")

    def picked(self, numbers: NDArray[np.int64]) -> Iterable[bytes]:
        """These rows as they are in the file, one by one."""
        size = self._dtype.itemsize
        for number in numbers.tolist():
            at = self._pieces[number // _ROWS].offset + number % _ROWS * size
            yield self._spool.get(at, size)

    def _column(self, name: str) -> NDArray[np.int64]:
        parts = (
            self._read(first, min(first + _ROWS, self._size))[name].copy()
            for first in range(0, self._size, _ROWS)
        )
        return np.concatenate(list(parts))

    def _read(self, first: int, end: int) -> NDArray[np.void]:
        size, parts = self._dtype.itemsize, []
        while first < end:
            last = min(end, (first // _ROWS + 1) * _ROWS)
            at = self._pieces[first // _ROWS].offset + first % _ROWS * size
            parts.append(self._spool.get(at, (last - first) * size))
            first = last
        return np.frombuffer(b"".join(parts), self._dtype)


class Writer:
    """A track while it is read from a bag, message by message."""

    def __init__(self, spool: DiskTrack) -> None:
        self._spool = spool
        self._pieces: list[_Piece] = []
        self._buffer = bytearray()
        self._row_size = 0
        self._size = 0
        self._last_ns = _NEVER
        self._in_order = True

    def add(self, stamp_ns: int, log_ns: int, values: Array) -> None:
        """Take a sample; of two with the same stamp, as a link that repeats gives them, the last counts."""
        if stamp_ns == self._last_ns and stamp_ns:
            del self._buffer[-self._row_size :]
            self._size -= 1
        elif stamp_ns <= self._last_ns:
            self._in_order = False
        self._last_ns = stamp_ns
        self._append(_HEAD.pack(stamp_ns, log_ns) + values.astype("<f8", copy=False).tobytes())

    def track(self) -> Track:
        """What was taken; there must be some, and no more may come."""
        found = self._written()
        if self._in_order:
            return found
        stamps = found.stamped()
        # Whoever sent them left the header empty: then they count from when they were logged.
        key = stamps if stamps.any() else found.logged()
        _, last = np.unique(key[::-1], return_index=True)
        order = key.size - 1 - last
        ordered = Writer(self._spool)
        for stamp_ns, row in zip(key[order].tolist(), found.picked(order), strict=True):
            ordered._append(_HEAD.pack(stamp_ns, 0) + row[_HEAD.size :])
        return ordered._written()

    def _append(self, row: bytes) -> None:
        self._row_size = len(row)
        # The last row stays in hand: the next may take its place.
        if len(self._buffer) == _ROWS * self._row_size:
            self._put()
        self._buffer += row
        self._size += 1

    def _put(self) -> None:
        first_ns, _ = _HEAD.unpack_from(self._buffer)
        self._pieces.append(_Piece(self._spool.put(self._buffer), first_ns))
        self._buffer.clear()

    def _written(self) -> Spooled:
        if self._buffer:
            self._put()
        return Spooled(self._spool, self._pieces, self._size, (self._row_size - _HEAD.size) // 8)
