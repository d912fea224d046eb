"""diagnostic_msgs/DiagnosticArray, decoded without ROS."""

from __future__ import annotations

import struct
from typing import NamedTuple

from ptnsbc_io.wire.cdr import align, byte_order, read_stamp, require, skip_string, string_at

_WHAT = "diagnostic_msgs/DiagnosticArray"


class DiagnosticStatus(NamedTuple):
    """One status of an array."""

    name: str  # "uav3: planner"
    level: int
    message: str
    values: dict[str, str]


class Diagnostics(NamedTuple):
    """A decoded array."""

    stamp_ns: int
    statuses: tuple[DiagnosticStatus, ...]


class _Cursor:
    """Reads the fields of a message one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._order = byte_order(data, _WHAT)
        self._at = 12  # after the encapsulation header and the stamp

    def stamp(self) -> int:
        return read_stamp(self._data, self._order, 4, _WHAT)

    def count(self) -> int:
        self._at = align(self._at, 4)
        require(self._data, self._at + 4, _WHAT)
        value = struct.unpack_from(f"{self._order}I", self._data, self._at)[0]
        self._at += 4
        return int(value)

    def text(self) -> str:
        start = align(self._at, 4)
        value = string_at(self._data, self._order, start, _WHAT)
        self._at = skip_string(self._data, self._order, start, _WHAT)
        return value

    def octet(self) -> int:
        require(self._data, self._at + 1, _WHAT)
        self._at += 1
        return self._data[self._at - 1]


def _status(cursor: _Cursor) -> DiagnosticStatus:
    level = cursor.octet()
    name, message = cursor.text(), cursor.text()
    cursor.text()  # hardware_id
    values = {}
    for _ in range(cursor.count()):
        key = cursor.text()
        values[key] = cursor.text()
    return DiagnosticStatus(name, level, message, values)


def decode_diagnostics(data: bytes) -> Diagnostics:
    """Stamp [ns] and statuses of a serialised DiagnosticArray."""
    cursor = _Cursor(data)
    stamp_ns = cursor.stamp()
    cursor.text()  # frame_id
    return Diagnostics(stamp_ns, tuple(_status(cursor) for _ in range(cursor.count())))
